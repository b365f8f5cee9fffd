// SPDX-License-Identifier: Apache-2.0

// Names and paths that a user has typed: what each means, and what is advised where it means
// nothing.

#include <cerrno>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/error.hpp"

#include "description/by_hand.hpp"
#include "record/pattern.hpp"
#include "support/error_of.hpp"
#include "tool/field_path.hpp"
#include "tool/nearest.hpp"
#include "tool/writers.hpp"

namespace {

using namespace by_hand;
using lot::testing::error_of;
using namespace lot::tool;

/// {points: [P] * 2, list: vector of P, to: reference to P, own: opaque, one: [P] * 1, empty: {}}
Description described() {
  return {{structure("", 8,
                     {field("points", 3, 0), field("list", 4, 0), field("to", 5, 0),
                      field("own", 7, 0), field("one", 8, 0), field("empty", 9, 0)}),
           structure("P", 8, {field("x", 2, 0), field("", 2, 0)}), type(Kind::Int, 8),
           type(Kind::Array, 16, "", 1, 2), type(Kind::Vector, 32, "", 1),
           type(Kind::Reference, 16, "", 6), type(Kind::Reference, 16, "", 1),
           type(Kind::Opaque, 8), type(Kind::Array, 8, "", 1, 1), structure("", 8, {})}};
}

}  // namespace

TEST_SUITE_BEGIN("paths");

TEST_CASE("a path leads to a type, or an error says where it goes wrong and what there is") {
  const std::pair<const char*, std::uint32_t> kPaths[] = {
      {"", 0},           {"points", 3}, {"points[0]", 1}, {"points[1].x", 2}, {"points[1]._1", 2},
      {"list[99].x", 2}, {"to", 1},     {"to.x", 2},      {"own", 7},         {"one[0]", 1},
      {"empty", 9},      {"_0[1]", 1}};
  for (const auto& [path, place] : kPaths) {
    CAPTURE(std::string(path));
    CHECK(type_at(described(), path) == place);
  }
  const std::string form =
      "it is no path to a field (Invalid argument); a path looks like "
      "labels[2].name";
  const std::string fields = "(Invalid argument); there are points, list, to, own, one, empty";
  const std::pair<const char*, std::string> kErrors[] = {
      {"pose", "the message has no field \"pose\" " + fields},
      {"points[2]",
       "points has 2 elements (Invalid argument); it has elements, the first of which "
       "is [0]"},
      {"one[1]",
       "one has 1 element (Invalid argument); it has elements, the first of which is [0]"},
      {"list.x",
       "list has no field \"x\" (Invalid argument); it has elements, the first of which "
       "is [0]"},
      {"[0]", "the message has no elements " + fields},
      {"points[1][0]", "points[1] has no elements (Invalid argument); there are x, _1"},
      {"points[1].y", "points[1] has no field \"y\" (Invalid argument); there are x, _1"},
      {"to._2", "to has no field \"_2\" (Invalid argument); there are x, _1"},
      {"own.x",
       "own has no field \"x\" (Invalid argument); it is opaque: only its own programs "
       "know what is in it"},
      {"empty.x", "empty has no field \"x\" (Invalid argument); it has no fields"},
      {"points[0].x.y", "points[0].x has no field \"y\" (Invalid argument); it is a single value"},
      {".points", form},
      {"points.", form},
      {"points..x", form},
      {"points[", form},
      {"points[]", form},
      {"points[x]", form},
      {"points[1 ]", form},
      {"points[-1]", form},
      {"points[99999999999999999999]", form},
      {"points[1]x", form},
      {"points]", form}};
  for (const auto& [path, says] : kErrors) {
    const auto [error, text] = error_of([wrong = path] { (void)type_at(described(), wrong); });
    CHECK(error == EINVAL);
    CHECK(text == std::string("lot: --field ") + path + ": " + says);
  }
  Description damaged = described();
  damaged.types[1].fields[0].type = 99;
  CHECK(error_of([&] { (void)type_at(damaged, "to.x"); }).first == EBADMSG);
  damaged.types[5].element = 5;  // a reference to itself comes to an end
  CHECK(type_at(damaged, "to") == 5);
}

TEST_CASE("two words are so many letters apart") {
  const std::pair<std::pair<const char*, const char*>, std::size_t> kWords[] = {
      {{"", ""}, 0},         {{"", "abc"}, 3},    {{"abc", ""}, 3},
      {{"abc", "abc"}, 0},   {{"abc", "abd"}, 1}, {{"abc", "ac"}, 1},
      {{"ac", "abc"}, 1},    {{"abc", "cab"}, 2}, {{"kitten", "sitting"}, 3},
      {{"pose", "poes"}, 2}, {{"a", "b"}, 1},     {{"abcd", "bcda"}, 2}};
  for (const auto& [words, apart] : kWords) {
    CHECK(letters_apart(words.first, words.second) == apart);
  }
}

TEST_CASE("for a name that is not there the one that is meant is told, or some that are") {
  struct Case {
    const char* wanted;
    std::vector<std::string> there;
    const char* advice;
  };
  const std::vector<std::string> many = {"/a", "/b", "/c", "/d", "/e", "/f"};
  const Case kCases[] = {
      {"/pose", {}, ""},
      {"pose", {"/pose"}, "there is /pose"},
      {"/pose", {"pose"}, "there is pose"},
      {"/poes", {"/image", "/pose"}, "there is /pose"},
      {"/posexy", {"/image", "/pose"}, "there is /pose"},
      {"/posexyz", {"/image", "/pose"}, "there are /image, /pose"},
      {"/ab", {"/c"}, "there is /c"},
      {"/x", {"/a", "/c"}, "there is /a"},
      {"xyz", {"abc", "def"}, "there are abc, def"},
      {"x", {"y"}, "there is y"},
      {"/none", many, "there are /a, /b, /c, /d and 2 more"},
      {"/none", {"/a", "/b", "/c", "/d"}, "there are /a, /b, /c, /d"},
      {"/none", {"/a", "/b", "/c", "/d", "/e"}, "there are /a, /b, /c, /d and 1 more"},
      {"cam*", {"/camera"}, "/cam* fits /camera"},
      {"/cam?", {"cam1"}, "cam? fits cam1"},
      {"/x*", {"/camera", "/pose"}, "there are /camera, /pose"},
      {"/cam[12", {"/cam1"}, "its [ has no ]"},
      {"/cam[", {}, "its [ has no ]"},
      {"/cam[]", {}, "its [ has no ]"},
      {"/cam[!]", {}, "its [ has no ]"},
      {"/cam[^]", {}, "its [ has no ]"},
      {"/cam[]]", {}, ""},
      {"/cam[!]]", {}, ""},
      {"/cam[^a]", {}, ""},
      {"/cam[1][2", {}, "its [ has no ]"},
      {"/cam\\[", {}, ""},
      {"/cam\\", {}, "it ends with a backslash"},
      {"/cam\\\\", {}, ""},
      {"/cam\\*\\", {}, "it ends with a backslash"}};
  for (const auto& [wanted, there, advice] : kCases) {
    CAPTURE(std::string(wanted));
    CHECK(advice_for(wanted, there) == advice);
  }
  for (const char* pattern : {"*", "a?", "[a", "\\"}) CHECK(lot::record::is_pattern(pattern));
  for (const char* name : {"", "/a_b.c", "]"}) CHECK(!lot::record::is_pattern(name));
  std::vector<std::string> names = {"b", "a", "b", "c", "a"};
  sort_out(names);
  CHECK(names == std::vector<std::string>{"a", "b", "c"});
}

TEST_CASE("the begin of a text ends with a whole character, where it is UTF-8") {
  const std::string text = "a\xc3\xb6\xe2\x82\xac\xf0\x9f\x98\x80z";  // 1, 2, 3, 4 and 1 bytes
  const std::size_t kEnds[] = {0, 1, 1, 3, 3, 3, 6, 6, 6, 6, 10, 11, 11};
  for (std::size_t most = 0; most < std::size(kEnds); ++most) {
    CAPTURE(most);
    CHECK(begin_of(text, most).size() == kEnds[most]);
  }
  CHECK(begin_of(std::string(9, '\x80'), 5).size() == 5);  // no UTF-8
  CHECK(begin_of("ab", ~std::uint64_t{0}) == "ab");
}

TEST_CASE("a character that steers a terminal is shown as a question mark, and no other") {
  const std::pair<const char*, const char*> kTexts[] = {
      {"a\x1f\x20\x7e\x7f", "a? ~?"},
      {"\xc2\x80\xc2\x9f\xc2\xa0", "??\xc2\xa0"},
      {"\xd8\x9b\xd8\x9c\xd8\x9d", "\xd8\x9b?\xd8\x9d"},  // U+061C
      {"\xe2\x80\x8d\xe2\x80\x8e\xe2\x80\x8f\xe2\x80\x90", "\xe2\x80\x8d??\xe2\x80\x90"},
      {"\xe2\x80\xa7\xe2\x80\xa8\xe2\x80\xae\xe2\x80\xaf", "\xe2\x80\xa7??\xe2\x80\xaf"},
      {"\xe2\x81\xa5\xe2\x81\xa6\xe2\x81\xa9\xe2\x81\xaa", "\xe2\x81\xa5??\xe2\x81\xaa"},
      {"\xef\xbb\xbe\xef\xbb\xbf\xef\xbc\x80", "\xef\xbb\xbe?\xef\xbc\x80"},  // U+FEFF
      {"\xf0\x9f\x98\x80\xf3\xa0\x80\x81", "\xf0\x9f\x98\x80\xf3\xa0\x80\x81"},
      {"a\xc3\xb6\xff\x1f~ ", "a????~ "}};
  for (const auto& [text, expected] : kTexts) CHECK(shown(text, 100) == expected);
  CHECK(shown("0123456789", 10) == "0123456789");
  CHECK(shown("0123456789a", 10) == "0123..789a");
  CHECK(shown("0123456789ab", 11) == "0123..89ab");
  CHECK(shown("\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6\xc3\xb6", 12) ==
        "\xc3\xb6\xc3\xb6..\xc3\xb6\xc3\xb6");
}

TEST_SUITE_END();
