// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <string_view>

/// What tests of recordings share: a directory of their own, and files as bytes.
namespace lot::testing {

/// A directory that goes with it.
class Directory {
 public:
  Directory() {
    char pattern[] = "/tmp/lot_record_XXXXXX";
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

/// Bytes of a file or of a message.
template <class Bytes>
std::string text(const Bytes& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace lot::testing
