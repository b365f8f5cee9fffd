// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <type_traits>

#if __cplusplus >= 202002L && __has_include(<stop_token>)
#include <stop_token>
#endif

#include "lot/detail/stop_word.hpp"

namespace lot {

namespace detail {

/// How a std::stop_token becomes a StopToken. No other type does.
template <class T>
struct FromStdToken : std::false_type {};

#ifdef __cpp_lib_jthread
/// The word of one conversion, which the std::stop_token sets.
struct StdStop {
  struct Set {
    StopWord* word;
    void operator()() const noexcept { word->set(); }
  };
  explicit StdStop(const std::stop_token& token) : callback(token, Set{&word}) {}

  StopWord word;
  std::stop_callback<Set> callback;
};

template <>
struct FromStdToken<std::stop_token> : std::true_type {
  static std::shared_ptr<StopWord> word(const std::stop_token& token) {
    if (!token.stop_possible()) return nullptr;
    const auto stop = std::make_shared<StdStop>(token);
    return {stop, &stop->word};
  }
};
#endif

}  // namespace detail

/// Ends waits early: of pulls, borrows, pops, takes, pushes, puts and calls, and WaitSet::run().
/// Once its StopSource has been told to stop, each call that begins with the token returns at once,
/// with Status::Stopped or with nothing, and takes nothing: also where there is something to be
/// had. One that waits ends, too; it may still take what comes at that moment. It stays so.
///
///     const lot::StopToken stop = lot::stop_on_signals();      // Ctrl-C
///     while (auto frame = puller.pull(stop)) show(*frame);
///
/// A std::stop_token (C++20) becomes one by itself. That costs an allocation, so convert it once.
///
/// Threads: as a std::shared_ptr: each thread its own copy. All copies may be used at once.
/// Errors:  only the conversion throws: std::bad_alloc.
/// Memory:  a word of the program's own, shared with its source and all copies.
/// Crash:   it leaves nothing: no other process knows of it.
class StopToken {
 public:
  /// One that never stops.
  StopToken() noexcept = default;
  /// One that stops when a std::stop_token does. Throws std::bad_alloc.
  template <class T, class = std::enable_if_t<detail::FromStdToken<T>::value>>
  StopToken(const T& token)  // NOLINT: implicit
      : word_(detail::FromStdToken<T>::word(token)) {}
  /// For StopSource.
  explicit StopToken(std::shared_ptr<const detail::StopWord> word) noexcept
      : word_(std::move(word)) {}

  /// True from when its source was told to stop. What the thread that called request_stop() wrote
  /// before it is seen then.
  [[nodiscard]] bool stop_requested() const noexcept { return word_ && word_->is_set(); }
  /// False: it never stops.
  [[nodiscard]] bool stop_possible() const noexcept { return word_ != nullptr; }

  /// True for tokens of one source, and for two that never stop.
  friend bool operator==(const StopToken& a, const StopToken& b) noexcept {
    return a.word_ == b.word_;
  }
  friend bool operator!=(const StopToken& a, const StopToken& b) noexcept { return !(a == b); }

  /// For the library: the word to sleep on, or null. It lives as long as the token.
  const detail::StopWord* word() const noexcept { return word_.get(); }

 private:
  std::shared_ptr<const detail::StopWord> word_;  ///< null: it never stops
};

/// Ends the waits that have one of its tokens.
///
///     lot::StopSource stopping;                                // a global one: for a handler
///     std::signal(SIGINT, [](int) { stopping.request_stop(); });
///
/// Copies are one source. Tokens outlive it.
///
/// Threads: request_stop() and stop_requested() at any time, also in a signal handler; the rest as
///          a std::shared_ptr.
/// Errors:  only the constructor throws: std::bad_alloc.
/// Memory:  as StopToken.
/// Crash:   as StopToken.
class StopSource {
 public:
  /// One that has not been told to stop. Throws std::bad_alloc.
  StopSource() : word_(std::make_shared<detail::StopWord>()) {}

  /// A token that stops when this is told to. Throws nothing.
  [[nodiscard]] StopToken get_token() const noexcept { return StopToken(word_); }
  /// Stops all its tokens, for ever, and wakes the threads that wait. True: this call was the
  /// first.
  bool request_stop() noexcept { return word_->set(); }
  /// True: it was told to stop.
  [[nodiscard]] bool stop_requested() const noexcept { return word_->is_set(); }

 private:
  std::shared_ptr<detail::StopWord> word_;
};

}  // namespace lot
