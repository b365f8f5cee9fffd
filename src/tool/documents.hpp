// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

#include <yaml-cpp/yaml.h>

#include "lot/stop_token.hpp"

namespace lot::tool {

/// The documents of a YAML text, one after the other. Of standard input each comes as soon as its
/// end is there: a line that begins with `---` or `...`, or the end of the input. Empty ones are
/// left out.
///
/// Threads: one.
class Documents {
 public:
  /// "-": of standard input.
  explicit Documents(const std::string& yaml);

  /// The next one. Nothing: there is none any more, or it was told to stop. Throws lot::Error:
  /// EINVAL for what is no YAML, with its line.
  std::optional<YAML::Node> next(const StopToken& stop);
  /// How many next() has given so far.
  std::size_t count() const noexcept { return count_; }
  /// The line in which a document of the last next() begins.
  std::size_t line() const noexcept { return document_line_; }

 private:
  void read(const StopToken& stop);
  bool cut();
  void take(std::size_t end);
  void parse(const std::string& document);

  std::string text_;
  std::size_t begin_ = 0;     ///< of the document that is not whole yet
  std::size_t line_at_ = 0;   ///< the begin of the first line that was not looked at
  std::size_t line_ = 0;      ///< which line of all the document begins with
  bool has_content_ = false;  ///< lines of the document that were looked at say something
  bool has_ended_;            ///< nothing comes any more behind text_
  struct Ready {
    YAML::Node node;
    std::size_t line;
  };
  std::deque<Ready> ready_;
  std::size_t count_ = 0;
  std::size_t document_line_ = 1;
};

}  // namespace lot::tool
