// SPDX-License-Identifier: Apache-2.0

// Numbers and tables as people read them: each unit's first and last number.

#include "tool/text.hpp"

#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

namespace {

using namespace lot::tool;

template <class Number>
using Texts = std::vector<std::pair<Number, const char*>>;

template <class Number, class Function>
void check(Function&& text, const Texts<Number>& table) {
  for (const auto& [number, expected] : table) CHECK(text(number) == expected);
}

std::string letters(std::size_t n) {
  std::string text;
  while (text.size() < n) text += static_cast<char>('a' + text.size() % 26);
  return text;
}

}  // namespace

TEST_SUITE_BEGIN("text");

TEST_CASE("bytes have two digits or whole units, and no unit has 1024 of the one below") {
  constexpr std::uint64_t kKiB = 1 << 10, kMiB = 1 << 20, kGiB = 1 << 30;
  check<std::uint64_t>(bytes_text, {{0, "0 B"},
                                    {1, "1 B"},
                                    {1023, "1023 B"},
                                    {kKiB, "1 KiB"},
                                    {kKiB + 1, "1.0 KiB"},
                                    {1536, "1.5 KiB"},
                                    {10188, "9.9 KiB"},
                                    {10189, "10 KiB"},
                                    {10 * kKiB + 600, "11 KiB"},
                                    {kMiB - 513, "1023 KiB"},
                                    {kMiB - 512, "1.0 MiB"},
                                    {kMiB, "1 MiB"},
                                    {312 * kMiB, "312 MiB"},
                                    {kGiB - 1, "1.0 GiB"},
                                    {kGiB, "1 GiB"},
                                    {kGiB * kKiB, "1 TiB"},
                                    {kGiB * kMiB, "1024 TiB"},
                                    {~std::uint64_t{0}, "16777216 TiB"}});
  check<double>(bandwidth_text, {{0, "0 B/s"},
                                 {0.4, "0 B/s"},
                                 {0.5, "1 B/s"},
                                 {1023.4, "1023 B/s"},
                                 {1023.5, "1 KiB/s"},
                                 {1e6, "977 KiB/s"},
                                 {3e6, "2.9 MiB/s"},
                                 {30 * 1048576.0, "30 MiB/s"}});
}

TEST_CASE("a count is exact below 100000, and no unit has 1000 of the one below") {
  check<std::uint64_t>(count_text, {{0, "0"},
                                    {99999, "99999"},
                                    {100000, "100k"},
                                    {100501, "101k"},
                                    {999499, "999k"},
                                    {999500, "1.0M"},
                                    {1234567, "1.2M"},
                                    {999949999, "999.9M"},
                                    {999950000, "1.0G"},
                                    {~std::uint64_t{0}, "18446744073.7G"}});
  check<double>(rate_text, {{0, "0.00/s"},
                            {0.25, "0.25/s"},
                            {0.949, "0.95/s"},
                            {0.951, "1.0/s"},
                            {30, "30.0/s"},
                            {999.94, "999.9/s"},
                            {999.95, "1.0k/s"},
                            {1500, "1.5k/s"},
                            {999949, "999.9k/s"},
                            {999950, "1.0M/s"},
                            {2.5e9, "2500.0M/s"}});
}

TEST_CASE("a precise rate has four digits") {
  check<double>(precise_rate_text, {{0, "0.0000/s"},
                                    {0.99989, "0.9999/s"},
                                    {0.9999, "1.000/s"},
                                    {9.9994, "9.999/s"},
                                    {9.9995, "10.00/s"},
                                    {29.97, "29.97/s"},
                                    {99.994, "99.99/s"},
                                    {99.995, "100.0/s"},
                                    {999.94, "999.9/s"},
                                    {999.95, "1.000k/s"},
                                    {999949, "999.9k/s"},
                                    {999950, "1.000M/s"},
                                    {1.2345e9, "1.234G/s"},
                                    {999.94e9, "999.9G/s"},
                                    {999.95e9, "1000G/s"},
                                    {2.5e12, "2500G/s"}});
}

TEST_CASE("a bound of a rate is never less than the rate") {
  check<double>(below_text, {{0.02, "< 0.1/s"},
                             {0.1, "< 0.1/s"},
                             {0.91, "< 1/s"},
                             {1, "< 1/s"},
                             {1.004, "< 1.1/s"},
                             {10.3, "< 10.3/s"},
                             {999.9, "< 999.9/s"},
                             {1000, "< 1k/s"},
                             {1001, "< 1.1k/s"},
                             {2500, "< 2.5k/s"},
                             {1e6, "< 1M/s"},
                             {2.41e6, "< 2.5M/s"},
                             {1e9, "< 1000M/s"}});
}

TEST_CASE("a time has three digits, or whole nanoseconds; an age is told in whole units") {
  check<double>(
      span_text,
      {{0, "0 ns"},           {1e-9, "1 ns"},          {-450e-9, "-450 ns"}, {999.4e-9, "999 ns"},
       {999.6e-9, "1.00 us"}, {-999.6e-9, "-1.00 us"}, {9.99e-6, "9.99 us"}, {9.995e-6, "10.0 us"},
       {32.14e-6, "32.1 us"}, {99.94e-6, "99.9 us"},   {99.95e-6, "100 us"}, {999.4e-6, "999 us"},
       {999.5e-6, "1.00 ms"}, {0.25, "250 ms"},        {0.9995, "1.00 s"},   {9.995, "10.0 s"},
       {12.34, "12.3 s"},     {99.95, "100 s"},        {123.4, "123 s"},     {1e6, "1000000 s"}});
  check<double>(age_text, {{0, "0 s"},
                           {0.9, "0 s"},
                           {119.9, "119 s"},
                           {120, "2 min"},
                           {7199, "119 min"},
                           {7200, "2 h"},
                           {48 * 3600 - 1, "47 h"},
                           {48 * 3600, "2 days"},
                           {3 * 86400 - 1, "2 days"}});
}

TEST_CASE("a name has no bytes that steer a terminal, and a long one is cut in its middle") {
  CHECK(printable(std::string("\0\x1f ~\x7f\x80\xff", 7)) == "?? ~???");
  CHECK(printable("0123456789", 10) == "0123456789");
  CHECK(printable("0123456789", 9) == "012..789");
  CHECK(printable("0123456789", 8) == "012..789");
  CHECK(printable("0123456789", 3) == "..");
  CHECK(printable(letters(60)) == letters(60));
  CHECK(printable(letters(61)) == letters(29) + ".." + letters(61).substr(32));
  CHECK(plural(0, "process", "processes") == "0 processes");
  CHECK(plural(1, "process", "processes") == "1 process");
  CHECK(plural(2, "process", "processes") == "2 processes");
}

TEST_CASE("a table's columns are as wide as their widest cells") {
  Table table({"NAME", "N", "MORE"}, {});
  CHECK(table.empty());
  CHECK(table.text() == "  NAME  N  MORE\n");
  table.add({"a", "12345", ""});
  table.add({"a long name", "1"});
  table.add_line("a line of its own, which is wider than the columns");
  table.add({"", "", "the last one"});
  CHECK(!table.empty());
  CHECK(table.text(" ") ==
        " NAME         N      MORE\n"
        " a            12345\n"
        " a long name  1\n"
        " a line of its own, which is wider than the columns\n"
        "                     the last one\n");
  Table hollow({"", "N"}, {});  // a column without a text takes no room
  hollow.add({"", "7"});
  CHECK(hollow.text() == "  N\n  7\n");
}

TEST_CASE("a table that is too wide has its widest elastic columns cut, down to nine characters") {
  const auto table = [](std::size_t first, std::size_t second, std::size_t third) {
    Table t({"A", "B", "C"}, {0, 1});
    t.add({letters(first), letters(second), letters(third)});
    return t.text().substr(t.text().find('\n') + 1);
  };
  const auto cell = [](std::size_t length, std::size_t width) {
    std::string text = printable(letters(length), width);
    text.resize(width, ' ');
    return text;
  };
  const auto row = [&](std::size_t first, std::size_t first_width, std::size_t second,
                       std::size_t second_width, std::size_t third) {
    return "  " + cell(first, first_width) + "  " + cell(second, second_width) + "  " +
           letters(third) + "\n";
  };
  CHECK(table(44, 40, 10) == row(44, 44, 40, 40, 10));  // 100 characters
  CHECK(table(44, 40, 12) == row(44, 42, 40, 40, 12));
  CHECK(table(40, 44, 12) == row(40, 40, 44, 42, 12));
  CHECK(table(60, 50, 10) == row(60, 42, 50, 42, 10));  // the first of two that are as wide
  CHECK(table(50, 50, 71) == row(50, 11, 50, 12, 71));
  CHECK(table(50, 50, 90) == row(50, 9, 50, 9, 90));
  CHECK(table(9, 9, 90) == row(9, 9, 9, 9, 90));
}

TEST_SUITE_END();
