// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/lot.hpp"

/// Types that all say they are the same one, some of them compiled as C++17.
namespace meeting {

/// One end of a topic.
class End {
 public:
  End() = default;
  virtual ~End() = default;
  End(const End&) = delete;
  End& operator=(const End&) = delete;
  /// A publisher publishes a message, a subscriber reads it; what it says.
  virtual std::string go() = 0;
};

/// A type, without its name.
struct Sample {
  const char* what;
  const lot::detail::MessageType& type;
  std::unique_ptr<End> (*advertise)(lot::ShmEngine& engine, const std::string& topic);
  std::unique_ptr<End> (*subscribe)(lot::ShmEngine& engine, const std::string& topic);
};

/// What a reference leads to.
struct Target {
  std::uint32_t value;
};

/// What each plain message has in its bytes: 1, 1.5F, 2.5F, where it has such fields.
inline constexpr unsigned char kBytes[12] = {1, 0, 0, 0, 0, 0, 0xc0, 0x3f, 0, 0, 0x20, 0x40};
inline constexpr const char* kText = "more text than a string keeps in itself";

template <class T, class = void>
inline constexpr bool has_text = false;
template <class T>
inline constexpr bool has_text<T, std::void_t<decltype(std::declval<T&>().text.data())>> = true;
template <class T, class = void>
inline constexpr bool has_reference = false;
template <class T>
inline constexpr bool has_reference<T, std::void_t<decltype(std::declval<T&>().target.get())>> =
    true;

template <class T>
class Publisher final : public End {
 public:
  Publisher(lot::ShmEngine& engine, const std::string& topic)
      : engine_(engine), pusher_(engine.advertise<T>(topic)) {}
  std::string go() override {
    auto message = pusher_.loan();
    std::string said;
    if constexpr (has_text<T>) {
      said = kText;
      for (const char c : said) {
        message->text.push_back(static_cast<typename decltype(T::text)::value_type>(c));
      }
    } else if constexpr (has_reference<T>) {
      auto target = engine_.make<std::remove_const_t<typename decltype(T::target)::element_type>>();
      target->value = 7;
      message->target =
          lot::ShmSharedPtr<typename decltype(T::target)::element_type>(std::move(target));
      said = "7";
    } else {
      said.assign(reinterpret_cast<const char*>(kBytes), sizeof(kBytes));
      std::memcpy(static_cast<void*>(message.get()), kBytes, sizeof(kBytes));
    }
    return pusher_.push(std::move(message)) == lot::Status::Ok ? said : "no push";
  }

 private:
  lot::ShmEngine& engine_;
  lot::ShmPusher<T> pusher_;
};

template <class T>
class Subscriber final : public End {
 public:
  Subscriber(lot::ShmEngine& engine, const std::string& topic)
      : puller_(engine.subscribe<T>(topic)) {}
  std::string go() override {
    const auto message = puller_.try_pull();
    if (!message) return "no message";
    if constexpr (has_text<T>) {
      return {message->text.begin(), message->text.end()};
    } else if constexpr (has_reference<T>) {
      return std::to_string(static_cast<int>(message->target->value));
    } else {
      return {reinterpret_cast<const char*>(message.get()), sizeof(kBytes)};
    }
  }

 private:
  lot::ShmPuller<T> puller_;
};

template <class T>
Sample sample(const char* what) {
  static_assert(sizeof(T) == 64 && alignof(T) == 64, "neither size nor alignment tells them apart");
  return {what, lot::detail::message_type<T>(),
          [](lot::ShmEngine& engine, const std::string& topic) -> std::unique_ptr<End> {
            return std::make_unique<Publisher<T>>(engine, topic);
          },
          [](lot::ShmEngine& engine, const std::string& topic) -> std::unique_ptr<End> {
            return std::make_unique<Subscriber<T>>(engine, topic);
          }};
}

/// Gives a type the name that all of them have, and a hash of its definition.
#define LOT_SAMPLE(Type, number)                             \
  template <>                                                \
  struct lot::TypeIdentity<Type> {                           \
    static const char* name() { return "sample"; }           \
    static constexpr std::uint64_t hash() { return number; } \
  }

/// Compiled as C++17: one without names, one whose names are given, one that is opaque.
Sample nameless_in_17();
Sample named_in_17();
Sample opaque_in_17();
/// With a struct of bit-fields in them: one without names, one whose own names are given alone, and
/// one where those of a struct in it are.
Sample beside_bits_in_17();
Sample partly_beside_bits_in_17();
Sample inner_beside_bits_in_17();
/// With a packed struct, all of whose names are given.
Sample beside_tight_in_17();

}  // namespace meeting
