// SPDX-License-Identifier: Apache-2.0

// A message is built by its description, and the type's own code has it then.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>
#ifndef _LIBCPP_VERSION
#include <boost/container/string.hpp>
#endif

#include "description/containers.hpp"
#include "readable.hpp"
#include "support/error_of.hpp"
#include "support/seed.hpp"

namespace {

using namespace readable;
using namespace std::chrono_literals;
using lot::MutableValue;
using lot::testing::error_of;
using lot::testing::names;

/// The arena of a message, which its containers know.
template <class T>
lot::detail::Arena* arena_of(const T& message) {
  return message.text.get_allocator().arena();
}

/// A loaned message whose bytes mean nothing, and then are made by its description.
template <class T>
struct Built : Place {
  Built() : message(engine.make<T>()), root(made()) {}

  lot::ShmUniquePtr<T> message;
  MutableValue root;

 private:
  MutableValue made() {
    lot::detail::Arena* const arena = arena_of(*message);
    std::memset(static_cast<void*>(message.get()), 0xa5, sizeof(T));
    MutableValue value = lot::detail::mutable_value_of(lot::describe<T>(), message.get(), arena);
    value.construct();
    return value;
  }
};

struct Texts {
  lot::ShmString text;
  lot::ShmVector<lot::ShmString> more;
};

/// What a typed reader finds is what it would have written itself.
bool alike(const Everything& a, const Everything& b) {
  const auto text = [](const Everything& e) {
    return to_string(lot::detail::value_of(lot::describe<Everything>(), &e), {100, 1000, 10'000});
  };
  return text(a) == text(b);
}

TEST_CASE("a message that is built by its description is what the type's code would have built") {
  Built<Everything> built;
  auto typed = built.engine.make<Everything>();
  fill(*typed);
  copy(lot::detail::value_of(lot::describe<Everything>(), typed.get()), built.root);
  const Everything& e = *built.message;
  CHECK(alike(e, *typed));
  CHECK(e.text == kLong);
  CHECK(e.labels.size() == 2);
  CHECK(e.labels[0].name == "short");
  CHECK(e.labels[0].notes[1] == kLong);
  CHECK(e.labels[0].name.get_allocator().arena() == arena_of(e));
  CHECK(e.tree.branches[1].branches[0].branches.get_allocator().arena() == arena_of(e));
  CHECK(e.rows[1] == typed->rows[1]);
  CHECK(e.bits.few == -9);
  CHECK(std::uint64_t{e.bits.most} == std::uint64_t{typed->bits.most});
  CHECK(e.when == typed->when);
  CHECK(e.frame == nullptr);
}

TEST_CASE("the type's code goes on with a message that was built: grows it, pushes it") {
  Built<Everything> built;
  auto typed = built.engine.make<Everything>();
  fill(*typed);
  copy(lot::detail::value_of(lot::describe<Everything>(), typed.get()), built.root);
  typed.reset();
  Everything& e = *built.message;
  for (int i = 0; i < 100; ++i) {
    e.labels.push_back(e.labels[0]);
    e.text += kLong;
    e.rows.emplace_back(7U, std::uint16_t{3});
    e.floats.insert(e.floats.begin(), 1.0F);
  }
  CHECK(e.labels[101].notes[1] == kLong);
  CHECK(e.labels[0].name == "short");
  CHECK(e.rows[101].size() == 7);
  e.tree.branches.erase(e.tree.branches.begin());
  CHECK(e.tree.branches[0].branches[0].number == 4);
  e.text.clear();
  e.text.shrink_to_fit();
  e.labels.clear();
  e.labels.shrink_to_fit();
  const Everything own = e;
  CHECK(own.floats.size() == 103);
  auto pusher = built.engine.advertise<Everything>("/built");
  auto puller = built.engine.subscribe<Everything>("/built");
  REQUIRE(pusher.push(std::move(built.message)) == lot::Status::Ok);
  const auto seen = puller.try_pull();
  REQUIRE(seen);
  CHECK(seen->rows[1][4] == 4);
}

TEST_CASE("numbers are set by path, if they fit, and an error names the path") {
  Built<Everything> built;
  const MutableValue& root = built.root;
  const Everything& e = *built.message;
  root.at("u8").set(255);
  CHECK(e.u8 == 255);
  const auto [error, text] = error_of([&] { root.at("u8").set(300); });
  CHECK(error == ERANGE);
  CHECK(names(text, "lot: u8: 300 does not fit a uint8"));
  CHECK(e.u8 == 255);
  for (const auto& [number, shown] :
       {std::pair(static_cast<long double>(1e300), "1e+300 does not fit a uint8"),
        std::pair(1.5L, "1.5 does not fit"),
        std::pair(0x1p10000L, "1.99506311688075838488e+3010 does not fit")}) {
    CHECK(names(error_of([&, n = number] { root["u8"].set(n); }).second, shown));
    CHECK(error_of([&, n = number] { root["u8"].set(n); }).second.size() < 100);
  }
  CHECK(error_of([&] { root["u8"].set(-1); }).first == ERANGE);
  CHECK(error_of([&] { root["u8"].set(1.5); }).first == ERANGE);
  root["u8"].set(7.0);
  CHECK(e.u8 == 7);
  root["i8"].set(-128);
  CHECK(e.i8 == -128);
  CHECK(error_of([&] { root["i8"].set(128); }).first == ERANGE);
  root["u64"].set(UINT64_MAX);
  root["i64"].set(INT64_MIN);
  CHECK(e.u64 == UINT64_MAX);
  CHECK(e.i64 == INT64_MIN);
  CHECK(error_of([&] { root["i64"].set(UINT64_MAX); }).first == ERANGE);
  root["f32"].set(0.1);
  CHECK(e.f32 == 0.1F);
  CHECK(error_of([&] { root["f32"].set(1e300); }).first == ERANGE);
  CHECK(error_of([&] { root["f64"].set(INT64_MAX); }).first == ERANGE);
  root["f64"].set(std::nan(""));
  CHECK(std::isnan(e.f64));
  root["real"].set(0.1L);
  CHECK(e.real == 0.1L);
  root["yes"].set(true);
  CHECK(e.yes);
  CHECK(error_of([&] { root["yes"].set(2); }).first == ERANGE);
  root["letter"].set('q');
  CHECK(e.letter == 'q');
  root["colour"].set(Colour::Red);
  CHECK(e.colour == Colour::Red);
  CHECK(error_of([&] { root["colour"].set(40'000); }).first == ERANGE);
  root.at("points[1].y").set(4);
  CHECK(e.points[1].y == 4);
  CHECK(error_of([&] { root["points"].set(4); }).first == EINVAL);
  CHECK(error_of([&] { root["text"].set(4); }).first == EINVAL);
  CHECK(error_of([&] { root["u8"].set("4"); }).first == EINVAL);
}

TEST_CASE("bit-fields are set, and their neighbours stay") {
  Built<Everything> built;
  const MutableValue bits = built.root["bits"];
  const Bits& is = built.message->bits;
  bits[0].set(5);
  bits[1].set(31);
  bits[0].set(2);
  CHECK(is.low == 2);
  CHECK(is.high == 31);
  bits[3].set(-16);
  bits[4].set(true);
  bits[5].set(15);
  CHECK(is.few == -16);
  CHECK(is.flag);
  CHECK(static_cast<int>(is.small) == 15);
  bits[6].set((1UL << 63) - 1);
  CHECK(std::uint64_t{is.most} == (1UL << 63) - 1);
  const auto [error, text] = error_of([&] { bits[0].set(8); });
  CHECK(error == ERANGE);
  CHECK(names(text, "lot: bits._0: 8 does not fit a uint8 of 3 bits"));
  CHECK(error_of([&] { bits[3].set(16); }).first == ERANGE);
  CHECK(error_of([&] { bits[3].set(-17); }).first == ERANGE);
  CHECK(error_of([&] { bits[6].set(1UL << 63); }).first == ERANGE);
  CHECK(is.high == 31);
  built.root["bits"]["_2"].set(-7);
  for (const std::size_t i : {0U, 3U, 6U}) bits[i].construct();
  CHECK(is.low == 0);
  CHECK(is.high == 31);
  CHECK(is.whole == -7);
  CHECK(is.few == 0);
  CHECK(is.flag);
  CHECK(static_cast<int>(is.small) == 15);
  CHECK(std::uint64_t{is.most} == 0);
}

TEST_CASE("times are set exactly, or not at all") {
  Built<Everything> built;
  const MutableValue& root = built.root;
  root["span"].set(2s);
  CHECK(built.message->span == 2s);
  CHECK(error_of([&] { root["span"].set(1us); }).first == ERANGE);
  CHECK(error_of([&] { root["span"].set(std::chrono::hours::max()); }).first == ERANGE);
  CHECK(built.message->span == 2s);
  root["seconds"].set(1ms);
  CHECK(built.message->seconds == 1ms);
  const auto now = std::chrono::system_clock::now();
  root["when"].set(now);
  CHECK(built.message->when == now);
  root["when"].set(5s);  // since the epoch
  CHECK(built.message->when.time_since_epoch() == 5s);
  CHECK(error_of([&] { root["when"].set(std::chrono::steady_clock::now()); }).first == EINVAL);
  CHECK(error_of([&] { root["u64"].set(1s); }).first == EINVAL);
}

TEST_CASE("texts of any length are set again and again") {
  Built<Texts> built;
  const MutableValue text = built.root["text"];
  for (const std::size_t size :
       {0U, 5U, 15U, 16U, 22U, 23U, 24U, 1000U, 3U, 1001U, 0U, 200'000U, 22U}) {
    const std::string wanted(size, static_cast<char>('a' + size % 26));
    text.set(wanted);
    CHECK(std::string_view(built.message->text) == wanted);
    CHECK(built.message->text.c_str()[size] == '\0');
    CHECK(built.message->text.capacity() >= size);
  }
  text.set(std::string("with\0zero", 9));
  CHECK(built.message->text.size() == 9);
  text.set(text.value().as<std::string_view>().substr(5));  // of itself
  CHECK(built.message->text == "zero");
}

TEST_CASE("a text goes into an array of char") {
  Built<Everything> built;
  const MutableValue name = built.root["name"];
  name.set("12345678");
  CHECK(std::memcmp(built.message->name, "12345678", 8) == 0);
  name.set("hi");
  CHECK(std::memcmp(built.message->name, "hi\0\0\0\0\0\0", 8) == 0);
  const auto [error, text] = error_of([&] { name.set("123456789"); });
  CHECK(error == ERANGE);
  CHECK(names(text, "lot: name: 9 bytes of text do not fit a char[8]"));
}

TEST_CASE("a vector that is resized keeps its elements, and what lies in them") {
  Built<Everything> built;
  const MutableValue labels = built.root["labels"];
  Everything& e = *built.message;
  labels.resize(1);
  labels.at("[0].name").set("short");
  labels.at("[0].notes[0]").set(kLong);
  for (const std::size_t size : {2U, 3U, 50U, 1000U}) {
    labels.resize(size);
    REQUIRE(e.labels.size() == size);
    CHECK(e.labels[0].name == "short");
    CHECK(e.labels[0].notes[0] == kLong);
    CHECK(e.labels[size - 1].name.empty());
    labels[size - 1]["name"].set(kLong);
    CHECK(e.labels[size - 1].name == kLong);
  }
  labels.resize(2);
  CHECK(e.labels.size() == 2);
  CHECK(e.labels.capacity() >= 1000);
  labels.resize(3);
  CHECK(e.labels[2].name.empty());
  CHECK(e.labels[1].name == kLong);

  const MutableValue branches = built.root.at("tree.branches");
  branches.resize(2);
  branches[1]["branches"].resize(3);
  branches.at("[1].branches[2].number").set(5);
  branches.resize(40);
  CHECK(e.tree.branches[1].branches[2].number == 5);
  CHECK(e.tree.branches[39].branches.empty());
  branches.resize(0);
  CHECK(e.tree.branches.empty());
  CHECK(error_of([&] { built.root["floats"].resize(std::size_t{1} << 62); }).first == ERANGE);
  CHECK(error_of([&] { built.root["numbers"].resize(4); }).first == EINVAL);
  CHECK(error_of([&] { built.root["text"].resize(4); }).first == EINVAL);
}

TEST_CASE("texts in elements that go are given back") {
  struct Pieces {
    unsigned char* next;
    int in_use;
  };
  const Fenced fenced;
  unsigned char* const begin = fenced.begin();
  Pieces pieces{begin + 4096, 0};
  const lot::detail::MessageMemory memory{
      &pieces,
      [](void* to, std::size_t bytes, std::size_t) {
        auto& all = *static_cast<Pieces*>(to);
        ++all.in_use;
        return static_cast<void*>(std::exchange(all.next, all.next + (bytes + 63) / 64 * 64));
      },
      [](void* of, void*, std::size_t) noexcept { --static_cast<Pieces*>(of)->in_use; }};
  const MutableValue texts(lot::describe<Texts>(), begin, begin, begin + Fenced::kBytes, memory);
  texts.construct();
  texts["more"].resize(2);
  const int without_texts = pieces.in_use;
  for (const std::size_t i : {0U, 1U}) texts["more"][i].set(kLong);
  CHECK(pieces.in_use == without_texts + 2);
  texts["more"].resize(0);
  CHECK(pieces.in_use == without_texts);
}

TEST_CASE("a vector that does not fit the segment throws OutOfMemory, and is what it was") {
  Built<Everything> built;
  const MutableValue floats = built.root["floats"];
  floats.resize(3);
  floats[2].set(2.5);
  CHECK(names(error_of([&] { floats.resize(1 << 28); }).second, "lot: "));
  CHECK(built.message->floats.size() == 3);
  CHECK(built.message->floats[2] == 2.5F);
  built.root["text"].set("before");
  CHECK_THROWS_AS(built.root["text"].set(std::string(80 << 20, 'x')), lot::OutOfMemory);
  CHECK(built.message->text == "before");
}

TEST_CASE("bytes become the elements of a vector or an array at once") {
  Built<Everything> built;
  const float values[] = {1, 2, 3, 4};
  const lot::Bytes bytes(reinterpret_cast<const std::byte*>(values), sizeof values);
  built.root["floats"].assign(bytes);
  CHECK(built.message->floats == lot::ShmVector<float>(values, values + 4));
  built.root["floats"].assign(lot::Bytes());
  CHECK(built.message->floats.empty());
  CHECK(error_of([&] { built.root["floats"].assign({bytes.data(), 7}); }).first == ERANGE);
  CHECK(error_of([&] { built.root["labels"].assign(bytes); }).first == EINVAL);
  CHECK(error_of([&] { built.root["numbers"].assign(bytes); }).first == EINVAL);
  built.root["numbers"].assign({bytes.data(), 6});
  CHECK(built.message->numbers[1] == 0x3f80);  // the upper half of 1
}

TEST_CASE("references, what they lead to, and opaque parts cannot be set or made") {
  Place place;
  auto frame = place.engine.make<Frame>();
  frame->stamp = 5;
  const lot::ShmSharedPtr<const Frame> target = std::move(frame);
  auto message = place.engine.make<Everything>();
  message->frame = target;
  const MutableValue root =
      lot::detail::mutable_value_of(lot::describe<Everything>(), message.get(), arena_of(*message));
  CHECK(names(error_of([&] { root["frame"].set(1); }).second, "a reference cannot be set"));
  const auto [error, text] = error_of([&] { root.at("frame.stamp").set(1); });
  CHECK(error == EINVAL);
  CHECK(names(text, "lot: frame.stamp: it lies in another message"));
  CHECK(target->stamp == 5);

  lot::ShmUniquePtr<HasSecret> secret = place.engine.make<HasSecret>();
  const MutableValue opaque = lot::detail::mutable_value_of(
      lot::describe<HasSecret>(), secret.get(), secret->more.get_allocator().arena());
  opaque["before"].set(3);
  CHECK(secret->before == 3);
  CHECK(error_of([&] { opaque["secret"].set(3); }).first == EINVAL);
  CHECK(error_of([&] { opaque["more"].resize(1); }).first == EINVAL);
  CHECK(error_of([&] { opaque["more"].assign({nullptr, 0}); }).first == EINVAL);
  CHECK(names(error_of([&] { opaque.construct(); }).second, "cannot be made here"));
  CHECK(secret->before == 3);
  CHECK(secret->secret.get() == 17);

  // What would let a reference go.
  struct References {
    lot::ShmVector<lot::ShmRef<const Frame>> all;
  };
  auto references = place.engine.make<References>();
  references->all.resize(2);
  references->all[1] = target;
  const MutableValue list = lot::detail::mutable_value_of(
      lot::describe<References>(), references.get(), references->all.get_allocator().arena());
  CHECK(names(error_of([&] { list["all"].resize(1); }).second, "cannot be let go"));
  list["all"].resize(9);
  CHECK(references->all[1] == target);
  CHECK(references->all[8] == nullptr);
  references->all.resize(1);
  list["all"].resize(0);
  CHECK(references->all.empty());
}

TEST_CASE("strings and vectors of libc++ are built wherever the library was") {
  using namespace lot::description;
  lot::Description all;
  all.types.resize(4);
  auto& root = all.types[0];
  root.kind = lot::Kind::Struct;
  root.size = BoostString::kSize + kVectorSize;
  root.fields = {{"text", 1, 0, 0, 0}, {"items", 2, BoostString::kSize, 0, 0}};
  all.types[1].kind = lot::Kind::String;
  all.types[1].size = BoostString::kSize;
  all.types[1].name = "libc++";
  all.types[2].kind = lot::Kind::Vector;
  all.types[2].size = kVectorSize;
  all.types[2].name = "libc++";
  all.types[2].element = 1;
  const Fenced fenced;
  const MutableValue made = fenced.make(all);
  for (const std::size_t size : {0U, 5U, 22U, 23U, 300U, 22U, 301U, 0U}) {
    made["text"].set(std::string(size, 'x'));
    CHECK(made["text"].value().as<std::string>() == std::string(size, 'x'));
  }
  made["items"].resize(2);
  made["items"][0].set("one");
  made["items"][1].set(kLong);
  made["items"].resize(9);
  CHECK(to_string(made["items"]) ==
        std::string("[\"one\", \"") + kLong + "\", \"\", \"\", \"\", \"\", \"\", \"\", \"\"]");
#ifndef _LIBCPP_VERSION
  // Boost's own string, which ShmString is with libc++.
  using Theirs =
      boost::container::basic_string<char, std::char_traits<char>, lot::ShmAllocator<char>>;
  static_assert(sizeof(Theirs) == BoostString::kSize);
  const auto& theirs = *static_cast<const Theirs*>(made["items"][1].value().address());
  CHECK(std::string(theirs.c_str()) == kLong);
  CHECK(theirs.capacity() == std::strlen(kLong));
  const auto& first = *static_cast<const Theirs*>(made["items"][0].value().address());
  CHECK(std::string(first.c_str()) == "one");
  static_cast<Theirs*>(const_cast<void*>(made["text"].value().address()))->assign("theirs");
  CHECK(made["text"].value().as<std::string>() == "theirs");
#endif
}

TEST_CASE("damage in a message that is built is an error, and no byte outside of it is written") {
  Place place;
  auto typed = place.engine.make<Everything>();
  fill(*typed);
  auto frame = place.engine.make<Frame>();
  const lot::ShmSharedPtr<const Frame> target = std::move(frame);
  typed->frame = target;
  const std::uint64_t seed = lot::testing::seed();
  CAPTURE(seed);
  std::mt19937_64 random(seed);
  std::size_t errors = 0;
  for (int i = 0; i < 1000; ++i) {
    const Fenced fenced;
    fenced.copy_of(lot::detail::value_of(lot::describe<Everything>(), typed.get()));
    const auto used = static_cast<std::size_t>(fenced.next() - fenced.begin());
    const MutableValue root = fenced.at_begin(lot::describe<Everything>());
    for (int n = 0; n < 4; ++n) {
      const std::size_t at = random() % (used / 8) * 8;
      const std::uint64_t word =
          random() % 2 == 0 ? random() >> (random() % 64) : random() % Fenced::kBytes - at;
      std::memcpy(fenced.begin() + at, &word, sizeof word);
    }
    const auto attempt = [&](const auto& what) {
      errors += error_of(what).second == "no error" ? 0 : 1;
    };
    attempt([&] { root["text"].set(kLong); });
    attempt([&] { root["text"].set("short"); });
    attempt([&] { root["labels"].resize(3); });
    attempt([&] { root.at("labels[1].name").set(kLong); });
    attempt([&] { root["labels"].resize(1); });
    attempt([&] { root["rows"].resize(1); });
    attempt([&] { root.at("tree.branches").resize(3); });
    attempt([&] { root.at("tree.branches").resize(0); });
    attempt([&] { root["floats"].resize(4); });
  }
  CHECK(errors > 100);
}

}  // namespace
