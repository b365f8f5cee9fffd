// SPDX-License-Identifier: Apache-2.0

// Reads and writes recordings for judge_test.py, as tests/mcap/judge.mjs does by @mcap/core.
//
//     recording stream FILE                       what is in it, read from the front
//     recording index FILE                        the same, by its index
//     recording recover FILE
//     recording write FILE none|lz4|zstd crc|no   makes one

#include <algorithm>
#include <cstdio>
#include <exception>
#include <iostream>
#include <string>
#include <vector>

#include "mcap/reader.hpp"
#include "mcap/recordings.hpp"
#include "mcap/recover.hpp"
#include "mcap/writer.hpp"

using namespace lot;
using namespace lot::testing;

namespace {

std::string hex(mcap::View bytes) {
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string digits;
  for (const std::byte b : bytes) {
    digits += kDigits[std::to_integer<unsigned>(b) >> 4];
    digits += kDigits[std::to_integer<unsigned>(b) & 15];
  }
  return digits;
}

std::string pairs(const mcap::Pairs& map) {
  std::string all;
  for (const auto& [key, value] : map) all += " " + key + "=" + value;
  return all;
}

std::string n(std::uint64_t number) { return " " + std::to_string(number); }

template <class Source>
void print_known(const Source& from) {
  std::cout << "header " << from.header().profile << "\n";
  for (const auto& [id, s] : from.schemas()) {
    std::cout << "schema" << n(id) << " " << s.name << " " << s.encoding << " " << hex(s.data)
              << "\n";
  }
  for (const auto& [id, c] : from.channels()) {
    std::cout << "channel" << n(id) << n(c.schema) << " " << c.topic << " " << c.message_encoding
              << pairs(c.metadata) << "\n";
  }
}

std::string words(const mcap::Message& message) {
  const mcap::MessageHead& h = message.head;
  return "message" + n(h.channel) + n(h.sequence) + n(h.log_time) + n(h.publish_time) + " " +
         hex(message.payload) + "\n";
}

/// Attachments and metadata, in the order of their words.
void print_others(mcap::Reader& reader) {
  std::vector<std::string> others;
  for (const auto& index : reader.attachments()) {
    const auto a = reader.read(index);
    others.push_back("attachment " + a.name + " " + a.media_type + n(a.log_time) +
                     n(a.create_time) + " " + hex(a.data) + "\n");
  }
  for (const auto& index : reader.metadata()) {
    const auto m = reader.read(index);
    others.push_back("metadata " + m.name + pairs(m.pairs) + "\n");
  }
  std::sort(others.begin(), others.end());
  for (const auto& other : others) std::cout << other;
}

void print_damage(const mcap::Damage& damage) {
  if (damage.any()) std::cerr << damage.first << "\n";
}

void stream(const std::string& path) {
  mcap::Stream source(path);
  std::string messages;
  while (const auto message = source.next()) messages += words(*message);
  print_known(source);
  std::cout << messages;
  mcap::Reader reader(path);
  print_others(reader);
  std::cout << "end " << (source.is_whole() ? "true" : "false") << "\n";
  print_damage(source.damage());
}

void index(const std::string& path) {
  mcap::Reader reader(path);
  print_known(reader);
  auto messages = reader.messages();
  while (const auto message = messages.next()) std::cout << words(*message);
  print_others(reader);
  const mcap::Statistics& s = reader.statistics();
  std::cout << "statistics" << n(s.messages) << n(s.schemas) << n(s.channels) << n(s.attachments)
            << n(s.metadata) << n(s.chunks) << n(s.start) << n(s.end);
  for (const auto& [channel, count] : s.channel_messages) std::cout << n(channel) << ":" << count;
  std::uint64_t some = 0;
  auto chosen = reader.messages({1010, 1050, {{reader.channels().begin()->first}}});
  while (const auto message = chosen.next()) some += message->head.channel;
  std::cout << "\nsome" << n(some) << "\n";
  print_damage(reader.damage());
}

void write_one(const std::string& path, const std::string& compression, bool crcs) {
  mcap::WriterOptions options;
  options.header = {"lot", "recording.cpp"};
  options.compression = mcap::compression_of(compression == "none" ? "" : compression);
  options.crcs = crcs;
  options.chunk_bytes = 3000;
  mcap::Writer writer(path, options);
  const auto schema = writer.add(mcap::Schema{0, "T", "lot", {std::byte{1}, std::byte{2}}});
  const std::uint16_t channels[] = {
      writer.add(mcap::Channel{0, schema, "/a", "lot", {{"b", "1"}, {"a", "2"}}}),
      writer.add(mcap::Channel{0, 0, "/b", "", {}}),
      writer.add(mcap::Channel{0, 0, "/never", "", {}})};
  for (unsigned i = 0; i < 300; ++i) {
    const std::uint64_t time = 1000 + i - i * 37 % 11;
    const std::size_t size = i % 50 == 3 ? 100000 : i % 7 * 30;
    put(writer, {channels[i % 2], i, time, i}, payload(i, size));
    if (i != 150) continue;
    writer.add(mcap::Attachment{7, 8, "notes", "text/plain", {std::byte{3}}});
    writer.add(mcap::Metadata{"machine", {{"host", "x"}, {"a", "b"}}});
  }
  writer.close();
}

}  // namespace

int main(int argc, char** argv) try {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.size() == 2 && words[0] == "stream") {
    stream(words[1]);
  } else if (words.size() == 2 && words[0] == "index") {
    index(words[1]);
  } else if (words.size() == 2 && words[0] == "recover") {
    mcap::recover(words[1]);
  } else if (words.size() == 4 && words[0] == "write") {
    write_one(words[1], words[2], words[3] == "crc");
  } else {
    std::fputs("recording: see its first lines\n", stderr);
    return 2;
  }
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
