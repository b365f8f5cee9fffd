// SPDX-License-Identifier: Apache-2.0

// Messages as JSON and YAML, and from YAML.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include "tool/values.hpp"

#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string>
#include <utility>

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>
#include <yaml-cpp/yaml.h>

#include <lot/lot.hpp>

#include "description/readable.hpp"
#include "support/error_of.hpp"
#include "tool/documents.hpp"

namespace {

using namespace readable;
using lot::MutableValue;
using lot::Value;
using lot::testing::error_of;
using lot::testing::names;
using lot::tool::to_json;
using lot::tool::to_yaml;

struct Fork {
  lot::ShmRef<const Fork> left, right;
  lot::ShmVector<lot::ShmRef<const Fork>> many;
};
struct Times {
  std::chrono::duration<double> seconds;
  std::chrono::duration<float, std::milli> span;
  std::chrono::duration<std::int64_t, std::ratio<1, 90000>> ticks;
};
struct Flags {
  bool each[2];
  lot::ShmVector<std::pair<bool, std::uint8_t>> pairs;
};
struct Limits {
  lot::ShmVector<std::int64_t> least;
  lot::ShmVector<std::uint64_t> most;
};
struct Second {
  lot::ShmRef<const lot::ShmRef<const Chain>> to;
};

struct Shown : Place {
  Shown() : message(engine.make<Everything>()) { fill(*message); }
  Value root() { return lot::detail::value_of(lot::describe<Everything>(), message.get()); }
  MutableValue mutable_root() {
    return lot::detail::mutable_value_of(lot::describe<Everything>(), message.get(),
                                         message->text.get_allocator().arena());
  }
  std::string json(const char* path) { return to_json(root().at(path)); }
  std::string yaml(const char* path) { return to_yaml(root().at(path)); }
  /// What fill() says of it.
  std::pair<int, std::string> filled(const char* text) {
    return error_of([&] { lot::tool::fill(mutable_root(), YAML::Load(text)); });
  }

  lot::ShmUniquePtr<Everything> message;
};

TEST_CASE("a Value becomes JSON, in which numbers are exact") {
  Shown shown;
  CHECK(shown.json("i64") == "-9223372036854775808");
  CHECK(shown.json("u64") == "18446744073709551615");
  CHECK(shown.json("wide") == "18446744073709551615");
  CHECK(shown.json("f32") == "0.1");
  CHECK(shown.json("f64") == "0.1");
  CHECK(shown.json("colour") == "-1");
  CHECK(shown.json("yes") == "true");
  CHECK(shown.json("letter") == "\"x\"");
  CHECK(shown.json("name") == "\"hi\"");
  CHECK(shown.json("span") == "\"-1.5s\"");
  CHECK(shown.json("when") == "\"1700000000.123456789s\"");
  CHECK(shown.json("points") == R"([{"x":1,"y":2},{"x":3,"y":4}])");
  CHECK(shown.json("rows") == "[[],[0,1,2,3,4]]");
  CHECK(shown.json("frame") == "null");
  CHECK(shown.json("nothing") == "{}");
  CHECK(shown.json("bits") == R"({"_0":5,"_1":17,"_2":-4,"_3":-9,"_4":true,"_5":7,)"
                              R"("_6":9223372036854775806})");
  shown.message->f64 = -std::numeric_limits<double>::infinity();
  CHECK(shown.json("f64") == "\"-inf\"");
  shown.message->f64 = std::nan("");
  CHECK(shown.json("f64") == "\"nan\"");
  shown.message->letter = '\n';
  CHECK(shown.json("letter") == "10");
}

TEST_CASE("a Value becomes YAML that reads as the same value") {
  Shown shown;
  CHECK(shown.yaml("floats") == "[1.5, -2, 3]\n");
  CHECK(shown.yaml("points") == "- x: 1\n  \"y\": 2\n- x: 3\n  \"y\": 4\n");
  CHECK(shown.yaml("text") == std::string("\"") + kLong + "\"\n");
  CHECK(shown.yaml("frame") == "~\n");
  CHECK(shown.yaml("span") == "\"-1.5s\"\n");
  shown.message->f64 = std::nan("");
  CHECK(shown.yaml("f64") == ".nan\n");
  shown.message->f32 = -std::numeric_limits<float>::infinity();
  CHECK(shown.yaml("f32") == "-.inf\n");
  shown.message->text = "true: \"no\"\n\xc3\xa4";
  CHECK(YAML::Load(shown.yaml("text")).as<std::string>() == "true: \"no\"\n\xc3\xa4");
}

TEST_CASE("a text that is no UTF-8 is told as bytes, also where it is cut") {
  Shown shown;
  const lot::TextLimits limits{16, 4, 100};
  const auto told = [&](const std::string& text) {
    shown.message->text.assign(text.data(), text.size());
    return to_json(shown.root()["text"], limits);
  };
  CHECK(told(std::string(100, '\x80')) == R"({"bytes":100,"first":{"base64":"gICAgA=="}})");
  CHECK(told("ab" + std::string(100, '\x80')) == R"({"bytes":102,"first":{"base64":"YWKAgA=="}})");
  CHECK(told("abc\xf0\x9f\x98\x80z") == R"({"bytes":8,"first":"abc"})");
  CHECK(told("abcd\xff") == R"({"bytes":5,"first":"abcd"})");
}

TEST_CASE("what Unicode calls no character goes through YAML, too") {
  Shown shown;
  Shown other;
  for (const char* text : {"a\xef\xbf\xbe", "\xef\xbf\xbf", "\xf0\x9f\xbf\xbf", "\xef\xb7\x90",
                           "\xf4\x8f\xbf\xbe", "\xf0\x9f\x98\x80"}) {
    CAPTURE(std::string(text));
    shown.message->text = text;
    CHECK(nlohmann::json::parse(shown.json("text")).get<std::string>() == text);
    lot::tool::fill(other.mutable_root(), YAML::Load("{text: " + shown.yaml("text") + "}"));
    CHECK(other.message->text == text);
  }
}

TEST_CASE("strings that are much together are left out as other values are") {
  Shown shown;
  shown.message->labels.resize(10);
  for (auto& label : shown.message->labels) label.name.assign(32'000, 'x');
  const std::string json = to_json(shown.root()["labels"], {~0ULL, ~0ULL, 5000});
  CHECK(nlohmann::json::accept(json));
  CHECK(json.size() > 2 * 32'000);
  CHECK(json.size() < 4 * 32'000);
  CHECK(names(json, R"("...")"));
}

TEST_CASE("what is long is cut in JSON and YAML, and its length is said") {
  Shown shown;
  shown.message->floats.assign(1000, 1.5F);
  const lot::TextLimits limits{2, 4, 1000};
  CHECK(to_json(shown.root()["floats"], limits) == R"({"elements":1000,"first":[1.5,1.5]})");
  CHECK(to_yaml(shown.root()["floats"], limits) == "elements: 1000\nfirst: [1.5, 1.5]\n");
  CHECK(to_json(shown.root()["text"], limits) == R"({"bytes":58,"first":"a te"})");
  shown.message->text = "abc\xc3\xa4";
  CHECK(to_json(shown.root()["text"], limits) == R"({"bytes":5,"first":"abc"})");
  CHECK(to_json(shown.root()["points"], {16, 80, 2}) == R"([{"x":"...","y":"..."},"..."])");

  auto frame = shown.engine.make<Frame>();
  frame->data.resize(16 << 20);
  const Value large = lot::detail::value_of(lot::describe<Frame>(), frame.get());
  CHECK(to_json(large).size() < 200);
  CHECK(to_yaml(large).size() < 200);
}

TEST_CASE("bytes that are no UTF-8 become base64, of opaque ones their type and digits are told") {
  Shown shown;
  shown.message->text.assign("\xff\x00\x01", 3);
  CHECK(shown.json("text") == R"({"base64":"/wAB"})");
  CHECK(shown.yaml("text") == "!!binary \"/wAB\"\n");
  for (const char* bad : {"\xc0\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xe2\x82", "\x80"}) {
    shown.message->text = bad;
    CHECK(names(shown.json("text"), "base64"));
  }
  shown.message->text = "\xf0\x9f\x98\x80";
  CHECK(shown.json("text") == R"("\uD83D\uDE00")");
  CHECK(shown.yaml("text") == "\"\xf0\x9f\x98\x80\"\n");
  auto secret = shown.engine.make<HasSecret>();
  secret->more.resize(20);
  const Value opaque = lot::detail::value_of(lot::describe<HasSecret>(), secret.get());
  CHECK(to_json(opaque["secret"]) == R"({"opaque":"readable::Secret","bytes":4,"hex":"11000000"})");
  CHECK(to_yaml(opaque["secret"], {16, 4, 100}) ==
        "opaque: \"readable::Secret\"\nbytes: 4\nhex: \"1100\"\n");
  CHECK(names(to_yaml(opaque["more"]), "elements: 20\nfirst:\n  - opaque: \"readable::Secret\"\n"));
}

TEST_CASE("no text of a message steers a terminal, and what reads the text gets the same") {
  Shown shown;
  const std::string raw =
      "a\x1b["
      "2Jb\x07\x7f\r\n\t\"\\\xc2\x9b\xe2\x80\xae\xe2\x81\xa6\xe2\x80\xa8\xef\xbb\xbf\xd8\x9c\xc3"
      "\xa4"
      "\xf0\x9f\x98\x80";
  shown.message->text.assign(raw.data(), raw.size());
  for (const std::string& text : {shown.json("text"), shown.yaml("text")}) {
    CAPTURE(text);
    CHECK(std::all_of(text.begin(), text.end() - 1,
                      [](unsigned char c) { return c >= ' ' && c < 0x80; }));
    CHECK(text.size() > raw.size());
  }
  CHECK(nlohmann::json::parse(shown.json("text")).get<std::string>() == raw);
  CHECK(YAML::Load(shown.yaml("text")).as<std::string>() == raw);

  lot::Description evil;  // as another process may give it
  evil.types.resize(2);
  evil.types[0].kind = lot::Kind::Struct;
  evil.types[0].size = 1;
  for (const char* name : {"\x1b[2J", "\xff", "a: b", "Yes", "~", "x1_", "1"}) {
    evil.types[0].fields.push_back({name, 1, 0, 0, 0});
  }
  evil.types[1].kind = lot::Kind::UInt;
  evil.types[1].size = 1;
  const unsigned char byte = 7;
  const Value value(evil, &byte, &byte, &byte + 1);
  CHECK(to_json(value) == R"({"\u001B[2J":7,"\uFFFD":7,"a: b":7,"Yes":7,"~":7,"x1_":7,"1":7})");
  CHECK(to_yaml(value) == R"("\x1b[2J": 7)"
                          "\n\"\xef\xbf\xbd\": 7\n\"a: b\": 7\n\"Yes\": 7\n\"~\": 7\n"
                          "x1_: 7\n\"1\": 7\n");
}

TEST_CASE("only what steers a terminal is escaped in YAML, and no umlaut beside it") {
  Shown shown;
  shown.message->text =
      "Gr\xc3\xb6\xc3\x9f"
      "e\n\x1b[2J\xc2\x9b";
  CHECK(shown.yaml("text") ==
        "\"Gr\xc3\xb6\xc3\x9f"
        "e\\n\\x1b[2J\\x9b\"\n");
}

TEST_CASE("an error is shown as it is, but for what steers a terminal") {
  using lot::tool::shown;
  CHECK(shown("gr\xc3\xb6\xc3\x9f"
              "e",
              100) ==
        "gr\xc3\xb6\xc3\x9f"
        "e");
  CHECK(shown("a\x1b[2J\xc2\x9b\xe2\x80\xae\n", 100) == "a?[2J???");
  CHECK(shown("a\xff\xc3\xb6", 100) == "a???");
  CHECK(shown(std::string(20, 'x'), 20) == std::string(20, 'x'));
  CHECK(shown(std::string(21, 'x'), 20) == std::string(9, 'x') + ".." + std::string(9, 'x'));
  for (std::size_t most = 10; most < 40; ++most) {  // no character is cut
    std::string text;
    for (int n = 0; n < 30; ++n) text += "\xf0\x9f\x98\x80\xc3\xb6";
    const std::string cut = shown(text, most);
    CHECK(cut.size() <= most);
    CHECK(cut.find('?') == cut.npos);
    CHECK(shown(cut, 1000) == cut);
  }
  Shown message;
  const std::string key(30, 'x');
  const auto what =
      message.filled(("{u8: " + key + "\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6}").c_str())
          .second;
  CHECK(names(shown(what, 1000), (key + "\xc3\xb6").c_str()));
}

TEST_CASE("references in a ring end in JSON and YAML") {
  Place place;
  lot::ShmSharedPtr<Chain> shared = place.engine.make<Chain>();
  shared->number = 3;
  shared->next = shared;
  const Value value = lot::detail::value_of(lot::describe<Chain>(), shared.get());
  const std::string json = to_json(value);
  CHECK(names(json, R"({"next":"...","number":3})"));
  CHECK(json.size() < 1000);
  CHECK(names(to_yaml(value), "\"...\""));
  shared->next = nullptr;

  lot::ShmSharedPtr<Fork> fork = place.engine.make<Fork>();
  fork->left = fork->right = fork;  // 2^64 ways through it
  fork->many.resize(100);
  for (auto& reference : fork->many) reference = fork;
  const Value forks = lot::detail::value_of(lot::describe<Fork>(), fork.get());
  const lot::TextLimits all{~0ULL, ~0ULL, 20'000};
  CHECK(nlohmann::json::accept(to_json(forks, all)));
  CHECK(to_json(forks, all).size() < 1'000'000);
  CHECK(to_yaml(forks, all).size() < 10'000'000);
  *fork = Fork();
}

TEST_CASE("a reference to a reference ends where that leads") {
  Place place;
  lot::ShmSharedPtr<Chain> chain = place.engine.make<Chain>();
  chain->number = 1;
  auto second = place.engine.make<Second>();
  second->to = lot::ShmSharedPtr<const lot::ShmRef<const Chain>>(chain, &chain->next);
  const Value value = lot::detail::value_of(lot::describe<Second>(), second.get());
  CHECK(to_json(value) == R"({"to":null})");
  CHECK(to_yaml(value) == "to: ~\n");
  chain->next = chain;
  CHECK(names(to_json(value), R"({"to":{"next":{"next":)"));
  chain->next = nullptr;
}

TEST_CASE("a picture of 16 MiB is written whole") {
  Place place;
  auto frame = place.engine.make<Frame>();
  frame->data.assign(16 << 20, 200);
  const Value picture = lot::detail::value_of(lot::describe<Frame>(), frame.get());
  const lot::TextLimits all{~0ULL, ~0ULL, 1ULL << 26};
  const std::string json = to_json(picture, all);
  CHECK(json.size() > 4 * (16 << 20));
  CHECK(json.ends_with(",200,200]}"));
  CHECK(to_json(picture["data"], {~0ULL, 80, 3}) == R"([200,200,"..."])");
  frame->data.resize(1 << 20);  // the other library takes its time
  CHECK(to_yaml(picture, all).ends_with(", 200, 200]\n"));
}

TEST_CASE("a token that is told to stop ends the writing of a large message") {
  Place place;
  auto frame = place.engine.make<Frame>();
  frame->data.assign(1 << 16, 200);
  const Value picture = lot::detail::value_of(lot::describe<Frame>(), frame.get());
  const lot::TextLimits all{~0ULL, ~0ULL, 1ULL << 26};
  lot::StopSource source;
  const auto stops = [&](auto writer) { return !write(writer, picture, all, source.get_token()); };
  CHECK(!stops(lot::tool::JsonWriter()));
  CHECK(!stops(lot::tool::YamlWriter()));
  source.request_stop();
  CHECK(stops(lot::tool::JsonWriter()));
  CHECK(stops(lot::tool::YamlWriter()));
  lot::tool::JsonWriter part;
  CHECK(!write(part, picture, all, source.get_token()));
  CHECK(part.take().size() < 8192);  // far from the end
}

TEST_CASE("a token that is told to stop ends the writing of one large text") {
  Shown shown;
  shown.message->text.assign(1 << 16, 'x');
  const lot::TextLimits all{~0ULL, ~0ULL, 1ULL << 26};
  lot::StopSource source;
  source.request_stop();
  lot::tool::JsonWriter writer;
  CHECK(!write(writer, shown.root().at("text"), all, source.get_token()));
}

TEST_CASE("lists of the largest numbers are written as they are") {
  Place place;
  auto limits = place.engine.make<Limits>();
  limits->least.push_back(INT64_MIN);
  limits->most.push_back(UINT64_MAX);
  const Value value = lot::detail::value_of(lot::describe<Limits>(), limits.get());
  CHECK(to_json(value["least"]) == "[-9223372036854775808]");
  CHECK(to_json(value["most"]) == "[18446744073709551615]");
}

TEST_CASE("YAML has the lines that people write") {
  Shown shown;
  CHECK(shown.yaml("tree") ==
        "number: 1\nbranches:\n  - number: 2\n    branches: []\n  - number: 3\n    branches:\n"
        "      - number: 4\n        branches: []\n");
  CHECK(shown.yaml("rows") == "- []\n- [0, 1, 2, 3, 4]\n");
  CHECK(shown.yaml("nothing") == "{}\n");
  CHECK(names(shown.yaml(""), "\nnothing: {}\nbits:\n  _0: 5\n"));
  CHECK(names(shown.yaml(""), "\npoints:\n  - x: 1\n    \"y\": 2\n"));
  shown.message->f64 = 1e20;
  CHECK(shown.yaml("f64") == "1.0e+20\n");
  CHECK(shown.json("f64") == "1e+20");
  shown.message->labels.clear();
  CHECK(names(shown.yaml(""), "\nlabels: []\n"));
  CHECK(to_yaml(shown.root()["rows"], {1, 80, 100}) == "elements: 2\nfirst:\n  - []\n");
}

TEST_CASE("a message that is filled from its own YAML is the same message") {
  Shown shown;
  const lot::TextLimits all{1000, 1000, 10'000};
  std::string yaml = to_yaml(shown.root(), all);
  Shown other;
  *other.message = Everything{};
  lot::tool::fill(other.mutable_root(), YAML::Load(yaml));
  CHECK(to_yaml(other.root(), all) == yaml);
  CHECK(other.message->real == shown.message->real);
  CHECK(other.message->labels[1].name == kLong);

  shown.message->text.assign("\xff\x00", 2);
  shown.message->f64 = std::nan("");
  yaml = to_yaml(shown.root(), all);
  lot::tool::fill(other.mutable_root(), YAML::Load(yaml));
  CHECK(other.message->text.size() == 2);
  CHECK(std::isnan(other.message->f64));
}

TEST_CASE("times of any period and size go through YAML") {
  Place place;
  auto from = place.engine.make<Times>();
  auto to = place.engine.make<Times>();
  const Value value = lot::detail::value_of(lot::describe<Times>(), from.get());
  const MutableValue other =
      lot::detail::mutable_value_of(lot::describe<Times>(), to.get(), nullptr);
  const double infinity = std::numeric_limits<double>::infinity();
  for (const double seconds : {5e-6, 0.1, -1.5, 100'000.0, 1e300, 1e-300, 0.0, 12345.678901234567,
                               infinity, -infinity, std::nan("")}) {
    CAPTURE(seconds);
    from->seconds = std::chrono::duration<double>(seconds);
    from->span = std::chrono::duration<float, std::milli>(seconds == 1e300 ? 0.F : 1e-6F);
    from->ticks = std::chrono::duration<std::int64_t, std::ratio<1, 90000>>(-7);
    const std::string yaml = to_yaml(value);
    CAPTURE(yaml);
    lot::tool::fill(other, YAML::Load(yaml));
    CHECK(
        (to->seconds == from->seconds || (std::isnan(seconds) && std::isnan(to->seconds.count()))));
    CHECK(to->span.count() == doctest::Approx(from->span.count()));
    CHECK(to->ticks == from->ticks);
  }
  lot::tool::fill(other, YAML::Load("{seconds: 2min, span: 1e-3s, ticks: 3s}"));
  CHECK(to->seconds.count() == 120);
  CHECK(to->span.count() == 1);
  CHECK(to->ticks.count() == 270'000);
  CHECK(error_of([&] { lot::tool::fill(other, YAML::Load("{seconds: 1e5000s}")); }).first ==
        ERANGE);
  for (const char* bad :
       {"{ticks: 7 * 1/0s}", "{ticks: 7 * -1/3s}", "{ticks: 7 * 1/3}", "{ticks: 7 * s}",
        "{ticks: 1e-6s}", "{seconds: s}", "{seconds: 1}", "{seconds: 1 s}"}) {
    CAPTURE(std::string(bad));
    CHECK(error_of([&] { lot::tool::fill(other, YAML::Load(bad)); }).first == EINVAL);
  }
}

TEST_CASE("bytes make no bool that is neither true nor false") {
  Place place;
  auto flags = place.engine.make<Flags>();
  const MutableValue value = lot::detail::mutable_value_of(lot::describe<Flags>(), flags.get(),
                                                           flags->pairs.get_allocator().arena());
  lot::tool::fill(value, YAML::Load("{each: !!binary AAE=, pairs: !!binary AQUABg==}"));
  CHECK(flags->each[1]);
  REQUIRE(flags->pairs.size() == 2);
  CHECK(flags->pairs[0] == std::pair(true, std::uint8_t{5}));
  const auto why = [&](const char* yaml) {
    return error_of([&] { lot::tool::fill(value, YAML::Load(yaml)); });
  };
  CHECK(why("{each: !!binary AgM=}").first == ERANGE);
  CHECK(names(why("{pairs: !!binary AQUCBg==}").second,
              "lot: pairs: element 1 would have a bool in it that is neither 0 nor 1"));
  CHECK(flags->pairs.size() == 2);
}

TEST_CASE("a char is a character in quotes, and a number without them") {
  Shown shown;
  const auto letter = [&](const char* text) {
    CHECK(shown.filled(text).second == "no error");
    return shown.message->letter;
  };
  CHECK(letter("{letter: \"7\"}") == '7');
  CHECK(letter("{letter: '7'}") == '7');
  CHECK(letter("{letter: 7}") == '\7');
  CHECK(letter("{letter: 0x41}") == 'A');
  CHECK(letter("{letter: -1}") == '\xff');
  CHECK(letter("{letter: a}") == 'a');
  CHECK(letter("{letter: -}") == '-');
  CHECK(letter("{letter: \"-\"}") == '-');
  for (int i = -128; i < 128; ++i) {
    CAPTURE(i);
    const auto c = static_cast<char>(i);
    for (const auto& text : {&Shown::yaml, &Shown::json}) {
      shown.message->letter = c;
      const std::string document = "{letter: " + (shown.*text)("letter") + "}";
      shown.message->letter = 'x';
      CHECK(letter(document.c_str()) == c);
    }
  }
}

TEST_CASE("a number beyond the range of its type is an error") {
  Shown shown;
  for (const char* text :
       {"{f64: 1e400}", "{f64: -1e400}", "{f32: 3.5e38}", "{f32: -1e39}", "{real: 1e5000}"}) {
    CAPTURE(text);
    const auto [error, what] = shown.filled(text);
    CHECK(error == ERANGE);
    CHECK(names(what, " does not fit a "));
  }
  CHECK(names(shown.filled("{f64: 1e400}").second, "lot: f64: 1e400 does not fit a float64"));
  CHECK(shown.filled("{f64: -.inf, f32: 3.4028235e38, real: 1e400}").second == "no error");
  CHECK(shown.message->f64 == -std::numeric_limits<double>::infinity());
  CHECK(shown.message->f32 == std::numeric_limits<float>::max());
  CHECK(shown.message->real == 1e400L);
}

TEST_CASE("what is larger than a double is a text in JSON, and infinity has its own") {
  Shown shown;
  shown.message->real = 0.1L;
  CHECK(shown.json("real") == "0.1");
  shown.message->real = std::numeric_limits<long double>::max();
  CHECK(shown.json("real") == "\"1.18973149535723176502e+4932\"");
  CHECK(shown.yaml("real") == "1.18973149535723176502e+4932\n");
  shown.message->real = -1e400L;
  const auto text = nlohmann::json::parse(shown.json("real")).get<std::string>();
  CHECK(std::strtold(text.c_str(), nullptr) == -1e400L);
  shown.message->real = -std::numeric_limits<long double>::infinity();
  CHECK(shown.json("real") == "\"-inf\"");
}

TEST_CASE("YAML sets what it names, and leaves the rest of a message") {
  Shown shown;
  CHECK(shown
            .filled("{u8: 0x10, floats: [1, .inf], labels: [{name: one}], yes: false,"
                    " name: abc, span: 2min, when: \"1.000000001s\", seconds: 1.5ms,"
                    " rows: [[1], [2, 3]], tree: {branches: [{number: 9}]}, letter: \"7\","
                    " colour: 7, pair: {second: -1e3}, text: 12, frame: ~}")
            .second == "no error");
  const Everything& e = *shown.message;
  CHECK(e.u8 == 16);
  CHECK(e.i8 == -8);
  CHECK(e.floats.size() == 2);
  CHECK(std::isinf(e.floats[1]));
  CHECK(e.labels.size() == 1);
  CHECK(e.labels[0].name == "one");
  CHECK(!e.yes);
  CHECK(std::memcmp(e.name, "abc\0\0\0\0\0", 8) == 0);
  CHECK(e.span == std::chrono::minutes(2));
  CHECK(e.when.time_since_epoch() == std::chrono::nanoseconds(1'000'000'001));
  CHECK(e.seconds.count() == doctest::Approx(0.0015));
  CHECK(e.rows[1][1] == 3);
  CHECK(e.tree.number == 1);
  CHECK(e.tree.branches[0].number == 9);
  CHECK(e.letter == '7');
  CHECK(e.colour == Colour::Red);
  CHECK(e.pair.second == -1000);
  CHECK(e.text == "12");
  CHECK(shown.filled("rows: [[], !!binary \"AQACAA==\"]").second == "no error");
  CHECK(e.rows[1] == lot::ShmVector<std::uint16_t>{1, 2});
}

TEST_CASE("YAML that does not fit a message is an error that names the path and what is there") {
  Shown shown;
  const auto why = [&](const char* text, int error = EINVAL) {
    const auto [number, what] = shown.filled(text);
    CHECK(number == error);
    return what;
  };
  CHECK(names(why("{yess: true}"), "lot: message: there is no field \"yess\""));
  CHECK(names(why("{yess: true}"), "there are yes, letter, i8"));
  CHECK(names(why("{labels: [{nam: 1}]}"), "lot: labels[0]: there is no field \"nam\""));
  CHECK(names(why("{u8: 300}", ERANGE), "lot: u8: 300 does not fit a uint8"));
  CHECK(names(why("{u8: -1}", ERANGE), "lot: u8: -1 does not fit a uint8"));
  CHECK(names(why("{u8: ten}"), "lot: u8: it is a uint8, and the YAML has \"ten\""));
  CHECK(names(why("{u8: \"10\"}"), "lot: u8: it is a uint8, and the YAML has \"10\""));
  CHECK(names(why("{u8: 1.5}"), "write a whole number"));
  CHECK(names(why("{u8: 0x}"), "write a whole number"));
  CHECK(names(why("{u8: }"), "and the YAML has nothing"));
  CHECK(names(why("{u64: 18446744073709551616}"), "write a whole number of at most 64 bits"));
  CHECK(names(why("{i64: -9223372036854775809}"), "write a whole number of at most 64 bits"));
  CHECK(names(why("{f64: [1]}"), "lot: f64: it is a float64, and the YAML has a list"));
  CHECK(names(why("{f64: 1x}"), "write a number"));
  CHECK(names(why("{f64: -}"), "write a number"));
  CHECK(names(why("{f64: nan}"), "write a number"));
  CHECK(names(why("{yes: 1}"), "write true or false"));
  CHECK(names(why("{yes: \"true\"}"), "write true or false"));
  CHECK(names(why("{text: [a]}"), "lot: text: it is a string, and the YAML has a list"));
  CHECK(names(why("{text: ~}"), "and the YAML has nothing"));
  for (const char* bad : {"*", "QUJD*A==", "AQIDBA", "AQI", "A===", "AQ=A", "=AAA",
                          "====", "\xc3\x84\xc3\x96\xc3\x9c="}) {
    CAPTURE(std::string(bad));
    CHECK(names(why((std::string("{text: !!binary \"") + bad + "\"}").c_str()), "write base64"));
  }
  CHECK(shown.filled("{text: !!binary \" QU\\n JD \"}").second == "no error");
  CHECK(shown.message->text == "ABC");
  CHECK(names(why("{name: 123456789}", ERANGE), "lot: name: 9 bytes of text do not fit a char[8]"));
  CHECK(names(why("{numbers: [1, 2]}"), "lot: numbers: it is a int16[3]"));
  CHECK(names(why("{numbers: [1, 2]}"), "write a list of 3, not of 2"));
  CHECK(names(why("{floats: 3}"), "lot: floats: it is a vector of float32"));
  CHECK(names(why("{floats: !!binary \"AQA=\"}", ERANGE), "no whole number of its elements"));
  CHECK(names(why("{span: 5}"), "write a time with a unit"));
  CHECK(names(why("{span: 1us}", ERANGE), "lot: span: 0.000001s is no whole number"));
  CHECK(names(why("{span: 1.2.3s}"), "write a time with a unit"));
  CHECK(names(why("{span: 1.0000000000000000000000001s}"), "less digits"));
  CHECK(names(why("{frame: {stamp: 1}}"), "a reference cannot be set"));
  CHECK(names(why("{u8: 1, u8: 2}"), "the YAML names the field \"u8\" twice"));
  CHECK(names(why("{yes: true, _0: false}"), "the YAML names the field \"_0\" twice"));
  CHECK(names(why("[1]"), "it is a readable::Everything, and the YAML has a list"));
  CHECK(names(why("{[1]: 2}"), "write a map of its fields"));
  CHECK(names(why("{letter: ab}"), "lot: letter: it is a char, and the YAML has \"ab\""));
  CHECK(names(why("{letter: \"12\"}"), "write one character of ASCII, in quotes, or without"));
  CHECK(names(why("{letter: [1]}"), "write one character of ASCII, in quotes, or without"));
}

TEST_CASE("a YAML text is cut into documents, each of which knows its line") {
  const auto told = [](const std::string& text) {
    lot::tool::Documents documents(text);
    std::string all;
    CHECK(documents.line() == 1);
    while (const auto node = documents.next(lot::StopToken())) {
      all += std::to_string(documents.count()) + "@" + std::to_string(documents.line()) + ":" +
             YAML::Dump(*node) + ";";
    }
    return all;
  };
  CHECK(told("") == "");
  CHECK(told("\n# nothing\n") == "");
  CHECK(told("---\n...\n---\n") == "");
  CHECK(told("7") == "1@1:7;");
  CHECK(told("7\n---\n8\n") == "1@1:7;2@3:8;");
  CHECK(told("---\n7\n---\n8\n...\n9") == "1@2:7;2@4:8;3@6:9;");
  CHECK(told("--- 7\n--- 8\n") == "1@1:7;2@2:8;");
  CHECK(told("---\t7\n---\r\n8") == "1@1:7;2@3:8;");
  CHECK(told("# one\n---\n7\n") == "1@3:7;");
  CHECK(told("%YAML 1.2\n---\n7\n...\n%YAML 1.2\n---\n8\n") == "1@3:7;2@7:8;");
  CHECK(told("\n\n \n7\n---\n\n---\n8\n") == "1@4:7;2@8:8;");
  CHECK(told("---7\n") == "1@1:---7;");
  CHECK(told("~\n---\n8\n") == "1@3:8;");
}

TEST_CASE("what is no YAML is told with its line and column, behind the documents before it") {
  lot::tool::Documents documents("7\n---\n\n{x: 1\n---\n8\n");
  CHECK(documents.next(lot::StopToken())->as<int>() == 7);
  const auto [number, text] = error_of([&] { (void)documents.next(lot::StopToken()); });
  CHECK(number == EINVAL);
  CHECK(names(text, "lot: the YAML: line 5, column 1: "));
  CHECK(names(text, "; quote it from the shell: lot pub TOPIC '{x: 1, name: left}'"));
  lot::tool::Documents deep(std::string(100000, '['));
  const auto error = error_of([&] { (void)deep.next(lot::StopToken()); });
  CHECK(error.first == EINVAL);
  CHECK(names(error.second, " deep in each other (Invalid argument); no message is as deep"));
}

}  // namespace
