// SPDX-License-Identifier: Apache-2.0
#include "tool/documents.hpp"

#include <algorithm>
#include <cerrno>
#include <poll.h>
#include <unistd.h>

#include <yaml-cpp/depthguard.h>

#include "lot/error.hpp"

namespace lot::tool {
namespace {

/// Whether a line is this mark, alone or with something behind it.
bool is_mark(std::string_view line, std::string_view mark) {
  if (line.substr(0, mark.size()) != mark) return false;
  const std::string_view behind = line.substr(mark.size());
  return behind.empty() || behind[0] == ' ' || behind[0] == '\t' || behind[0] == '\r';
}

/// Whether a line has more than blanks, a comment or a directive (%YAML).
bool says_something(std::string_view line) {
  const std::size_t begin = line.find_first_not_of(" \t\r");
  return begin != line.npos && line[begin] != '#' && line[0] != '%';
}

}  // namespace

Documents::Documents(const std::string& yaml) : has_ended_(yaml != "-") {
  if (has_ended_) text_ = yaml;
}

std::optional<YAML::Node> Documents::next(const StopToken& stop) {
  while (ready_.empty()) {
    if (cut()) continue;
    if (has_ended_) {
      if (begin_ == text_.size()) return std::nullopt;
      take(text_.size());
      continue;
    }
    if (stop.stop_requested()) return std::nullopt;
    read(stop);
  }
  const Ready first = ready_.front();
  ready_.pop_front();
  document_line_ = first.line;
  ++count_;
  return first.node;
}

/// More of standard input, when it comes.
void Documents::read(const StopToken& stop) {
  constexpr int kBetweenLooks = 100;  // milliseconds
  text_.erase(0, begin_);
  line_at_ -= begin_;
  begin_ = 0;
  pollfd input{STDIN_FILENO, POLLIN, 0};
  while (poll(&input, 1, kBetweenLooks) != 1) {
    if (stop.stop_requested()) return;
  }
  char more[1 << 16];
  const ssize_t n = ::read(STDIN_FILENO, more, sizeof(more));
  if (n < 0 && errno != EINTR && errno != EAGAIN) {
    throw Error(errno, "standard input", "the YAML can not be read", "");
  }
  if (n == 0) has_ended_ = true;
  if (n > 0) text_.append(more, static_cast<std::size_t>(n));
}

/// Takes the first document whose end is there. False: there is none.
bool Documents::cut() {
  for (std::size_t end; (end = text_.find('\n', line_at_)) != text_.npos;) {
    const auto line = std::string_view(text_).substr(line_at_, end - line_at_);
    if (is_mark(line, "...")) {
      take(end + 1);
      return true;
    }
    const bool begins = is_mark(line, "---");
    if (begins && has_content_) {
      take(line_at_);
      return true;
    }
    has_content_ = has_content_ || says_something(begins ? line.substr(3) : line);
    line_at_ = end + 1;
  }
  return false;
}

/// Takes what lies before `end`.
void Documents::take(std::size_t end) {
  const std::string document = text_.substr(begin_, end - begin_);
  begin_ = line_at_ = end;
  has_content_ = false;
  parse(document);
  line_ += static_cast<std::size_t>(std::count(document.begin(), document.end(), '\n'));
}

void Documents::parse(const std::string& document) {
  try {
    for (const YAML::Node& node : YAML::LoadAll(document)) {
      const auto line = line_ + static_cast<std::size_t>(node.Mark().line) + 1;
      if (!node.IsNull()) ready_.push_back({node, line});
    }
  } catch (const YAML::DeepRecursion& e) {
    throw Error(
        EINVAL, "the YAML",
        "its lists and maps lie more than " + std::to_string(e.depth() - 1) + " deep in each other",
        "no message is as deep");
  } catch (const YAML::Exception& e) {
    throw Error(EINVAL, "the YAML",
                "line " + std::to_string(line_ + static_cast<std::size_t>(e.mark.line) + 1) +
                    ", column " + std::to_string(e.mark.column + 1) + ": " + e.msg,
                "quote it from the shell: lot pub TOPIC '{x: 1, name: left}'");
  }
}

}  // namespace lot::tool
