// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "lot/lot.hpp"

/// What a shared object with its own copy of the library offers to its host, as a nodelet does.
namespace lot::testing {

struct Part {
  ShmString name;
  ShmVector<std::uint32_t> numbers;
};
struct Frame {
  std::uint64_t number;
  ShmString text;
  ShmVector<std::uint64_t> data;
  ShmVector<Part> parts;
};
struct Link {
  ShmRef<const Frame> frame;
};

inline constexpr std::size_t kWords = 50000;
inline const char* const kText = "a text that is much too long for the small string in place";

inline void fill(Frame& frame, std::uint64_t number) {
  frame.number = number;
  frame.text = kText;
  for (std::size_t i = 0; i < kWords; ++i) frame.data.push_back(number + i);  // it grows
  frame.parts.resize(3);
  frame.parts[1].name = kText;
  frame.parts[2].numbers.assign(1000, static_cast<std::uint32_t>(number));
}
inline bool good(const Frame& frame, std::uint64_t number) {
  return frame.number == number && frame.text == kText && frame.data.size() == kWords &&
         frame.data.front() == number && frame.data.back() == number + kWords - 1 &&
         frame.parts.size() == 3 && frame.parts[1].name == kText &&
         frame.parts[2].numbers.size() == 1000 && frame.parts[2].numbers[999] == number;
}

/// All pointers go over this interface as C++ objects.
class Plugin {
 public:
  virtual ~Plugin() = default;
  /// Joins; advertises and subscribes "/NAME".
  virtual void join(const EngineOptions& options, const std::string& name) = 0;
  virtual ShmSharedPtr<const Frame> make(std::uint64_t number) = 0;
  virtual ShmUniquePtr<Frame> loan(std::uint64_t number) = 0;
  virtual Status push(const ShmSharedPtr<const Frame>& frame) = 0;
  virtual Status push(ShmUniquePtr<Frame>&& frame) = 0;
  virtual ShmSharedPtr<const Frame> pull() = 0;
  /// Keeps a pointer until it is given another one (or null); returns the one before.
  virtual ShmSharedPtr<const Frame> keep(const ShmSharedPtr<const Frame>& frame) = 0;
  virtual ShmWeakPtr<const Frame> watch() const = 0;
  /// The number of what is kept, through a reference in a message of the plugin's own.
  virtual std::uint64_t refer() = 0;
  /// Lets engine, pusher and puller go; what is kept stays.
  virtual void leave() = 0;
};

/// What each plugin exports.
using MakePlugin = Plugin* (*)();

}  // namespace lot::testing
