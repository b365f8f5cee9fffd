// SPDX-License-Identifier: Apache-2.0

// How large a message is for `lot bw`, and which time it has for `lot delay --field`.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/boost_containers.hpp>
#include <lot/lot.hpp>

#include "description/readable.hpp"
#include "support/error_of.hpp"
#include "tool/message_bytes.hpp"
#include "tool/time_field.hpp"

namespace sizes {

struct Fixed {
  std::uint64_t number;
  std::array<float, 16> values;
};
struct Listed {
  lot::ShmList<std::uint32_t> numbers;
};
struct InPlace {
  boost::container::static_vector<std::uint32_t, 100> numbers;
};
struct Stamp {
  std::uint32_t sec, nsec;
};
struct Header {
  std::uint32_t seq;
  Stamp stamp;
  lot::ShmString frame_id;
};
struct Laps {
  lot::ShmVector<Header> laps;
};
/// Only its own program knows what it counts from.
struct OwnClock {
  using duration = std::chrono::seconds;
  using rep = duration::rep;
  using period = duration::period;
  using time_point = std::chrono::time_point<OwnClock>;
  static constexpr bool is_steady = false;
};
struct Whole {
  std::uint32_t sec;
};
struct Timed {
  Header header;
  Whole whole;
  std::chrono::system_clock::time_point taken;
  std::chrono::time_point<std::chrono::steady_clock, std::chrono::microseconds> read;
  std::chrono::nanoseconds since_boot;
  std::chrono::duration<double> since_1970;
  std::array<Stamp, 2> more;
  OwnClock::time_point own;
};
struct InParts {
  Stamp time;
};
struct InOne {
  std::chrono::nanoseconds time;
};
struct Secs {
  std::int32_t secs, nsecs;
};
struct TvSec {
  std::int64_t tv_sec, tv_nsec;
};
struct Seconds {
  std::uint64_t seconds, nanoseconds;
};
struct Nanosec {
  std::int32_t sec;
  std::uint32_t nanosec;
};
struct SecondOne {
  float sec;
  std::uint32_t other;
  std::uint32_t seconds;
  float nsec;
  std::uint32_t nanosec;
};
struct RestAlone {
  std::uint32_t nsec;
};
struct Spellings {
  Secs secs;
  TvSec tv_sec;
  Seconds seconds;
  Nanosec nanosec;
  SecondOne second_one;
  RestAlone rest_alone;
};

}  // namespace sizes

namespace {

using namespace readable;
using namespace sizes;
using namespace std::chrono_literals;
using lot::testing::error_of;
using lot::testing::names;
using lot::tool::bytes_by_memory;
using lot::tool::MessageBytes;
using lot::tool::TimeField;

struct Places {
  lot::EngineOptions options = lot::testing::fresh();
  lot::ShmEngine engine{options};

  template <class T>
  std::uint64_t bytes(const lot::ShmUniquePtr<T>& message) {
    const MessageBytes sizes(lot::describe<T>());
    REQUIRE(sizes.is_exact());
    return sizes.of(lot::detail::value_of(lot::describe<T>(), message.get()));
  }
};

TimeField::Now now_at(std::chrono::nanoseconds system, std::chrono::nanoseconds steady) {
  return {system, steady};
}

}  // namespace

TEST_SUITE_BEGIN("sizes");

TEST_CASE("the size of a message is its struct, and what its vectors and strings hold") {
  Places here;
  const MessageBytes fixed(lot::describe<Fixed>());
  CHECK(fixed.is_constant());
  CHECK(fixed.type_size() == sizeof(Fixed));
  CHECK(here.bytes(here.engine.make<Fixed>()) == sizeof(Fixed));

  auto frame = here.engine.make<Frame>();
  CHECK(!MessageBytes(lot::describe<Frame>()).is_constant());
  CHECK(here.bytes(frame) == sizeof(Frame));
  frame->encoding = "rgb8";  // lies in the struct
  CHECK(here.bytes(frame) == sizeof(Frame));
  frame->data.resize(921600);
  CHECK(here.bytes(frame) == sizeof(Frame) + 921600);
  frame->encoding = std::string(100, 'x').c_str();
  CHECK(here.bytes(frame) == sizeof(Frame) + 921600 + 100);

  auto label = here.engine.make<Label>();  // strings in an array
  label->notes[1] = std::string(40, 'y').c_str();
  CHECK(here.bytes(label) == sizeof(Label) + 40);

  auto tree = here.engine.make<Tree>();  // a type in itself
  tree->branches.resize(3);
  tree->branches[1].branches.resize(2);
  tree->branches[1].branches[0].branches.resize(1);
  CHECK(here.bytes(tree) == 7 * sizeof(Tree));

  auto chain = here.engine.make<Chain>();  // what it refers to is another message
  CHECK(MessageBytes(lot::describe<Chain>()).is_constant());
  CHECK(here.bytes(chain) == sizeof(Chain));
}

TEST_CASE("of what no description explains the memory says the size") {
  CHECK(!MessageBytes(lot::describe<Listed>()).is_exact());
  CHECK(!MessageBytes(lot::describe<InPlace>()).is_exact());
  CHECK(bytes_by_memory(256, sizeof(Listed)) == sizeof(Listed));
  CHECK(bytes_by_memory(4096, sizeof(Listed)) == 4096);
  CHECK(bytes_by_memory(256, sizeof(InPlace)) == 256);  // smaller than the type: damage
  CHECK(bytes_by_memory(4096, sizeof(InPlace)) == sizeof(InPlace));
  CHECK(bytes_by_memory(8192, sizeof(InPlace)) == 8192);
  CHECK(bytes_by_memory(8192, 5000) == 5000);
  CHECK(bytes_by_memory(12288, 5000) == 12288);
}

TEST_CASE("a damaged message has no size") {
  Places here;
  auto frame = here.engine.make<Frame>();
  frame->data.resize(100);
  unsigned char whole[sizeof(Frame)];
  std::memcpy(whole, static_cast<const void*>(frame.get()), sizeof(whole));
  std::memset(static_cast<void*>(&frame->data), 0x5a, sizeof(frame->data));
  CHECK(error_of([&] { (void)here.bytes(frame); }).first == EBADMSG);
  std::memcpy(static_cast<void*>(frame.get()), whole, sizeof(whole));
  CHECK(here.bytes(frame) == sizeof(Frame) + 100);
}

TEST_CASE("a time in a message is told from the right clock") {
  Places here;
  auto message = here.engine.make<Timed>();
  const auto system = 1700000000s + 123456789ns;
  const auto steady = 5000s;
  const auto age = [&](const std::string& path, TimeField::Clock clock) {
    TimeField field(path);
    field.begin(lot::describe<Timed>());
    const auto value = lot::detail::value_of(lot::describe<Timed>(), message.get());
    const auto found = field.age(value, now_at(system, steady));
    if (found) CHECK(field.clock() == clock);
    return found;
  };
  using Clock = TimeField::Clock;
  for (const char* path :
       {"header.stamp", "taken", "read", "since_boot", "since_1970", "more[1]"}) {
    CAPTURE(path);
    CHECK(!age(path, Clock::Unknown));  // it is zero
  }
  message->header.stamp = {1700000000, 100000000};
  CHECK(age("header.stamp", Clock::System) == 23456789ns);
  message->header.stamp = {1700000001, 0};
  CHECK(age("header.stamp", Clock::System) == 123456789ns - 1s);  // it lies ahead
  message->more[1] = {4999, 999999999};
  CHECK(age("more[1]", Clock::Steady) == 1ns);
  message->taken = std::chrono::system_clock::time_point(system - 5ms);
  CHECK(age("taken", Clock::System) == 5ms);
  message->read = decltype(message->read)(4999s);
  CHECK(age("read", Clock::Steady) == 1s);
  message->since_boot = 4000s;
  CHECK(age("since_boot", Clock::Steady) == 1000s);
  message->since_1970 = std::chrono::duration<double>(1700000000);
  CHECK(age("since_1970", Clock::System) == 123456789ns);
  message->since_1970 = std::chrono::duration<double>(1e300);  // any number may stand there
  CHECK(*age("since_1970", Clock::System) < -24h * 365 * 50);
}

TEST_CASE("the clock of a number of seconds is that of the first one of its type") {
  Places here;
  auto message = here.engine.make<Timed>();
  TimeField field("since_boot");
  field.begin(lot::describe<Timed>());
  const auto age = [&](std::chrono::nanoseconds time) {
    message->since_boot = time;
    return field.age(lot::detail::value_of(lot::describe<Timed>(), message.get()),
                     now_at(1700000000s, 5000s));
  };
  CHECK(age(4999s) == 1s);
  CHECK(age(1699999999s) == 5000s - 1699999999s);
  field.begin(lot::describe<Timed>());
  CHECK(age(1699999999s) == 1s);
}

TEST_CASE("a field that has no time is refused, and the words say which would do") {
  const auto error = [](const std::string& path) {
    return error_of([&] { TimeField(path).begin(lot::describe<Timed>()); });
  };
  for (const char* path : {"header.seq", "header", "header.frame_id", "header.stamp.sec", "more",
                           "none", "more[2]", "own", "whole", ""}) {
    CAPTURE(std::string(path));
    CHECK(error(path).first == EINVAL);
  }
  CHECK(names(error("header.seq").second, "struct of sec and nsec"));
  CHECK(names(error("own").second, "OwnClock"));
  CHECK(names(error("header.time").second, "stamp"));
}

TEST_CASE("vectors of a forged message that lie in each other again and again have an end") {
  using readable::Tree;
  Place place;
  constexpr std::size_t kLevels = 20;  // a million ways
  std::vector<lot::ShmUniquePtr<Tree>> levels;
  for (std::size_t k = 0; k < kLevels; ++k) {
    levels.push_back(place.engine.make<Tree>());
    levels.back()->branches.resize(2);
  }
  using Words = std::array<std::uint64_t, sizeof(levels[0]->branches) / sizeof(std::uint64_t)>;
  std::vector<std::pair<Words*, Words>> before;
  const auto copy = [&before](Tree& to,
                              const Tree& from) {  // pointers are relative to their places
    auto* const words = reinterpret_cast<Words*>(&to.branches);
    const auto distance = reinterpret_cast<std::uintptr_t>(&from.branches) -
                          reinterpret_cast<std::uintptr_t>(&to.branches);
    before.emplace_back(words, *words);
    std::memcpy(words, &from.branches, sizeof(*words));
    for (std::uint64_t& word : *words) word += distance;
  };
  for (std::size_t k = 0; k + 1 < kLevels; ++k) {
    for (Tree& branch : levels[k]->branches) copy(branch, *levels[k + 1]);
  }
  const lot::Description& description = lot::describe<Tree>();
  const lot::tool::MessageBytes bytes(description, 10'000);
  const auto root = lot::detail::value_of(description, levels[0].get());
  CHECK(error_of([&] { (void)bytes.of(root); }).first == EBADMSG);
  const auto leaf = lot::detail::value_of(description, levels[kLevels - 10].get());
  CHECK(bytes.of(leaf) > 1000 * sizeof(Tree));
  for (const auto& [words, were] : before) *words = were;
}

TEST_CASE("a time behind a vector that is too short is refused in this message alone") {
  Places here;
  TimeField field("laps[1].stamp");
  field.begin(lot::describe<Laps>());
  auto message = here.engine.make<Laps>();
  const auto age = [&] {
    return field.age(lot::detail::value_of(lot::describe<Laps>(), message.get()),
                     now_at(1700000000s, 5000s));
  };
  message->laps.resize(1);
  CHECK(error_of([&] { (void)age(); }).first == EINVAL);
  message->laps.resize(2);
  message->laps[1].stamp = {1699999999, 0};
  CHECK(age() == 1s);
}

TEST_CASE("memory is the type alone from one byte above it to the end of its last granule") {
  const std::tuple<std::uint64_t, std::uint64_t, std::uint64_t> kSizes[] = {
      {0, 0, 0},          {256, 0, 256},       {255, 100, 255},     {256, 100, 100},
      {257, 100, 257},    {4096, 100, 4096},   {256, 256, 256},     {4096, 256, 4096},
      {257, 257, 257},    {256, 257, 256},     {258, 257, 257},     {4096, 257, 257},
      {4097, 257, 4097},  {4096, 4095, 4095},  {4097, 4095, 4097},  {8192, 4095, 8192},
      {4096, 4096, 4096}, {8192, 4096, 4096},  {8193, 4096, 8193},  {8192, 8191, 8191},
      {8193, 8191, 8193}, {12288, 8192, 8192}, {12289, 8192, 12289}};
  for (const auto& [memory, type, bytes] : kSizes) {
    CAPTURE(memory);
    CAPTURE(type);
    CHECK(bytes_by_memory(memory, type) == bytes);
  }
}

TEST_CASE("a field that has another type now is read as that type") {
  Places here;
  auto parts = here.engine.make<InParts>();
  auto span = here.engine.make<InOne>();
  parts->time = {4999, 999999999};
  span->time = 4998s;
  const auto now = now_at(1700000000s, 5000s);
  TimeField field("time");
  CHECK(field.clock() == TimeField::Clock::Unknown);
  for (int k = 0; k < 2; ++k) {
    field.begin(lot::describe<InParts>());
    CHECK(field.clock() == TimeField::Clock::Unknown);
    CHECK(field.age(lot::detail::value_of(lot::describe<InParts>(), parts.get()), now) == 1ns);
    CHECK(field.clock() == TimeField::Clock::Steady);
    field.begin(lot::describe<InOne>());
    CHECK(field.clock() == TimeField::Clock::Unknown);
    CHECK(field.age(lot::detail::value_of(lot::describe<InOne>(), span.get()), now) == 2s);
  }
}

TEST_CASE("seconds and nanoseconds have five names each, and are whole numbers") {
  Places here;
  auto message = here.engine.make<Spellings>();
  message->secs = {4000, 5};
  message->tv_sec = {4001, 6};
  message->seconds = {4002, 7};
  message->nanosec = {4003, 8};
  message->second_one = {1.5F, 9, 4004, 1.5F, 10};
  const auto age = [&](const std::string& path) {
    TimeField field(path);
    field.begin(lot::describe<Spellings>());
    return field.age(lot::detail::value_of(lot::describe<Spellings>(), message.get()),
                     now_at(1700000000s, 5000s));
  };
  CHECK(age("secs") == 1000s - 5ns);
  CHECK(age("tv_sec") == 999s - 6ns);
  CHECK(age("seconds") == 998s - 7ns);
  CHECK(age("nanosec") == 997s - 8ns);
  CHECK(age("second_one") == 996s - 10ns);
  const auto [number, text] = error_of([&] { (void)age("rest_alone"); });
  CHECK(number == EINVAL);
  CHECK(text ==
        "lot: --field rest_alone: it is no time (Invalid argument); name a time point, a duration, "
        "or a struct of sec and nsec");
}

TEST_CASE("the nearer clock is told to the nanosecond, and any number is a time or none") {
  Places here;
  auto message = here.engine.make<Timed>();
  const auto age = [&](const char* path, TimeField::Clock clock) {
    TimeField field(path);
    field.begin(lot::describe<Timed>());
    const auto found = field.age(lot::detail::value_of(lot::describe<Timed>(), message.get()),
                                 now_at(9000s, 5000s));
    CHECK(field.clock() == clock);
    return found;
  };
  using Clock = TimeField::Clock;
  message->since_boot = 7000s - 1ns;
  CHECK(age("since_boot", Clock::Steady) == 1ns - 2000s);
  message->since_boot = 7000s;  // as far from both
  CHECK(age("since_boot", Clock::System) == 2000s);
  message->since_boot = 7000s + 1ns;
  CHECK(age("since_boot", Clock::System) == 2000s - 1ns);
  message->since_1970 = std::chrono::duration<double>(std::nan(""));
  CHECK(!age("since_1970", Clock::Unknown));
  constexpr std::chrono::nanoseconds kMost(std::int64_t{1} << 62);
  message->since_1970 = std::chrono::duration<double>(1e300);
  CHECK(age("since_1970", Clock::System) == 9000s - kMost);
  message->since_1970 = std::chrono::duration<double>(-1e300);
  CHECK(age("since_1970", Clock::Steady) == 5000s + kMost);
}

TEST_SUITE_END();
