// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <iterator>
#include <stdexcept>
#include <string>
#include <string_view>
#include <unistd.h>
#include <utility>
#include <vector>

#include "mcap/reader.hpp"
#include "mcap/writer.hpp"

/// What the tests of recordings share: a directory of their own, files as bytes, and messages that
/// follow from a number.
namespace lot::testing {

/// A directory that goes with it.
class Directory {
 public:
  Directory() {
    char pattern[] = "/tmp/lot_mcap_XXXXXX";
    if (mkdtemp(pattern) == nullptr) throw std::runtime_error("mkdtemp");
    path_ = pattern;
  }
  ~Directory() { std::filesystem::remove_all(path_); }
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  std::string file(const std::string& name = "a.mcap") const { return path_ + "/" + name; }

 private:
  std::string path_;
};

inline mcap::View view(std::string_view text) { return std::as_bytes(std::span(text)); }
inline std::string text(mcap::View bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

inline std::string read_file(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw std::runtime_error("cannot read " + path);
  return {std::istreambuf_iterator<char>(stream), {}};
}
/// Makes a file of these bytes. A file that is there is written over and then cut: one that is
/// emptied first is written to the disk when it is closed (ext4), for which a test of thousands
/// waits.
inline void write_file(const std::string& path, std::string_view bytes) {
  std::ofstream(path, std::ios::binary | std::ios::app);  // it is there
  std::ofstream stream(path, std::ios::binary | std::ios::in);
  stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!stream.flush()) throw std::runtime_error("cannot write " + path);
  std::filesystem::resize_file(path, bytes.size());
}

/// Bytes of a given number, half of them alike, that follow from `seed`.
inline std::string payload(std::uint64_t seed, std::size_t size) {
  std::string bytes(size, static_cast<char>('a' + seed % 26));
  std::uint64_t state = seed * 2654435761u + 1;
  for (std::size_t i = 0; i < size; ++i) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    if ((i >> 6) % 2 == 0) bytes[i] = static_cast<char>(state >> 56);
  }
  return bytes;
}

inline void put(mcap::Writer& writer, const mcap::MessageHead& head, std::string_view bytes) {
  const mcap::View piece = view(bytes);
  writer.write(head, std::span(&piece, 1));
}

/// A message in one line.
inline std::string line(const mcap::Message& message) {
  const mcap::MessageHead& h = message.head;
  return std::to_string(h.channel) + " " + std::to_string(h.sequence) + " " +
         std::to_string(h.log_time) + " " + std::to_string(h.publish_time) + " " +
         text(message.payload);
}

/// All that a Stream, or the messages of a Reader, still gives.
template <class Source>
std::vector<std::string> lines(Source&& source) {
  std::vector<std::string> all;
  while (const auto message = source.next()) all.push_back(line(*message));
  return all;
}

}  // namespace lot::testing
