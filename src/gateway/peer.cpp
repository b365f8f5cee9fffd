// SPDX-License-Identifier: Apache-2.0
#include "gateway/peer.hpp"

#include <cerrno>
#include <charconv>
#include <cstdint>
#include <fstream>
#include <sys/stat.h>
#include <system_error>

#include "lot/error.hpp"

#include "mcap/records.hpp"
#include "record/types.hpp"
#include "segment/segment.hpp"

namespace lot::gateway {
namespace {

constexpr const char* kSegment = "lot.segment";
constexpr const char* kLedger = "lot.ledger";
constexpr const char* kWritten = "lot.written";
/// DDS sends user data in one piece, in which other things must have room, too.
constexpr std::size_t kMostUserData = 60'000;
constexpr std::string_view kHex = "0123456789abcdef";

/// Of keys and values: what separates them is written as %XX.
std::string escaped_value(std::string_view text) {
  std::string result;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == ';' || c == '=' || c == '%' || byte < ' ') {
      result += '%';
      result += kHex[byte >> 4];
      result += kHex[byte & 15];
    } else {
      result += c;
    }
  }
  return result;
}

std::string unescaped_value(std::string_view text) {
  std::string result;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const std::size_t high = i + 2 < text.size() ? kHex.find(text[i + 1]) : kHex.npos;
    const std::size_t low = i + 2 < text.size() ? kHex.find(text[i + 2]) : kHex.npos;
    if (text[i] == '%' && high != kHex.npos && low != kHex.npos) {
      result += static_cast<char>(high << 4 | low);
      i += 2;
    } else {
      result += text[i];
    }
  }
  return result;
}

std::string text_of(const mcap::Pairs& pairs) {
  std::string text;
  for (const auto& [key, value] : pairs) text += key + "=" + escaped_value(value) + ";";
  return text;
}

/// 0: it is not there, or no number.
std::uint64_t number_in(const mcap::Pairs& pairs, const char* key) {
  const auto found = pairs.find(key);
  std::uint64_t number = 0;
  if (found == pairs.end()) return 0;
  const std::string& text = found->second;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  return error == std::errc() && end == text.data() + text.size() ? number : 0;
}

mcap::Pairs pairs_of_text(std::string_view text) {
  mcap::Pairs pairs;
  while (!text.empty()) {
    const std::string_view pair = text.substr(0, text.find(';'));
    text.remove_prefix(pair.size() == text.size() ? pair.size() : pair.size() + 1);
    const std::size_t equals = pair.find('=');
    if (equals == std::string_view::npos) continue;
    pairs[std::string(pair.substr(0, equals))] = unescaped_value(pair.substr(equals + 1));
  }
  return pairs;
}

}  // namespace

std::string place_of(const segment::Segment& segment) {
  std::string boot;
  std::getline(std::ifstream("/proc/sys/kernel/random/boot_id"), boot);
  struct stat file {};
  if (stat(segment.path().c_str(), &file) != 0) {
    throw Error(errno, segment.path(), "the segment's file can not be looked at", "");
  }
  return boot + ":" + std::to_string(file.st_dev) + ":" + std::to_string(file.st_ino);
}

std::string user_data_of(const Peer& peer) {
  mcap::Pairs own{{kSegment, peer.segment}};
  if (peer.ledger != 0) {
    own[kLedger] = std::to_string(peer.ledger);
    own[kWritten] = std::to_string(peer.written);
  }
  mcap::Pairs pairs;
  if (peer.type) pairs = record::pairs_of(peer.type);
  pairs.insert(own.begin(), own.end());
  const std::string text = text_of(pairs);
  return text.size() > kMostUserData ? text_of(own) : text;
}

std::optional<Peer> peer_of(std::string_view user_data) {
  const mcap::Pairs pairs = pairs_of_text(user_data);
  const auto segment = pairs.find(kSegment);
  if (segment == pairs.end()) return std::nullopt;
  return Peer{segment->second, record::type_of(pairs), number_in(pairs, kLedger),
              number_in(pairs, kWritten)};
}

}  // namespace lot::gateway
