// SPDX-License-Identifier: Apache-2.0

// A recording with edits is read by each reader, and recovered: an error, or messages and a count
// of what was skipped. Never a crash, a hang, an access outside, or more memory than there is to
// read. Without edits all messages come back, by each reader and after recovery of each cut.
//
// Input: which recording (compression, CRCs, how many messages); then edits, each of a place and
// what is to be there: a byte, a number of 8 bytes, or the end of the file. (corpus/mcap/ has
// examples)

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <string>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include "lot/error.hpp"
#include "lot/fuzz.hpp"

#include "mcap/reader.hpp"
#include "mcap/recover.hpp"
#include "mcap/writer.hpp"
#include "support/directory.hpp"
#include "support/plant.hpp"

namespace {

namespace mcap = lot::mcap;
using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;

using Lines = std::vector<std::string>;

const std::string& path() {
  static const auto* const directory = new lot::fuzz::Directory;
  static const std::string file = directory->path() + "/fuzz.mcap";
  return file;
}

std::string line(const mcap::Message& message) {
  const mcap::MessageHead& h = message.head;
  std::string text = std::to_string(h.channel) + "," + std::to_string(h.sequence) + "," +
                     std::to_string(h.log_time) + ":";
  return text.append(reinterpret_cast<const char*>(message.payload.data()), message.payload.size());
}

template <class Source>
Lines lines(Source&& source) {
  Lines all;
  while (const auto message = source.next()) all.push_back(line(*message));
  if (planted("lost_message") && !all.empty()) all.pop_back();
  if (planted("changed_payload") && !all.empty()) ++all.back().back();
  return all;
}

/// Writes a recording, and says what is in it.
Lines write(Bytes& bytes, bool& crcs) {
  std::filesystem::remove(path());
  mcap::WriterOptions options;
  options.compression = static_cast<mcap::Compression>(bytes.below(3));
  options.crcs = crcs = bytes.below(2) == 0;
  options.chunk_bytes = 64 + bytes.byte();
  mcap::Writer writer(path(), options);
  const auto schema = writer.add(mcap::Schema{0, "S", "e", {std::byte{1}}});
  for (const char* topic : {"/a", "/b"}) writer.add(mcap::Channel{0, schema, topic, "", {}});
  Lines expected;
  for (auto i = static_cast<unsigned>(bytes.below(12)); i != 0; --i) {
    const std::string payload(1 + bytes.byte(), static_cast<char>('a' + i));
    const mcap::MessageHead head{static_cast<std::uint16_t>(1 + i % 2), i, 100 - i, i};
    const mcap::View piece = std::as_bytes(std::span(payload));
    writer.write(head, std::span(&piece, 1));
    expected.push_back(line({head, piece}));
  }
  writer.add(mcap::Attachment{1, 2, "n", "t", {std::byte{1}}});
  writer.add(mcap::Metadata{"m", {{"k", "v"}}});
  writer.close();
  return expected;
}

/// Changes the file, and says how many bytes it changes; a cut counts as one.
unsigned edit(Bytes& bytes) {
  const int fd = open(path().c_str(), O_RDWR | O_CLOEXEC);
  struct stat status {};
  require(fd != -1 && fstat(fd, &status) == 0, "the file");
  const auto size = static_cast<std::uint64_t>(status.st_size);
  unsigned changed = 0;
  while (bytes.left() != 0) {
    const unsigned kind = bytes.byte() % 4;
    const auto at = static_cast<off_t>(bytes.number<std::uint16_t>() % size);
    std::uint64_t number = 0;
    if (kind == 0) {
      require(ftruncate(fd, at) == 0, "ftruncate");
    } else if (kind == 1) {
      number = bytes.byte();
      require(pwrite(fd, &number, 1, at) == 1, "pwrite");
    } else {
      number = kind == 2 ? bytes.number<std::uint64_t>() : ~std::uint64_t{0} >> bytes.byte() % 64;
      require(pwrite(fd, &number, sizeof(number), at) == sizeof(number), "pwrite");
    }
    changed += kind <= 1 ? 1 : sizeof(number);
  }
  close(fd);
  return changed;
}

/// What a Stream gives, after all that a Reader gives was looked at.
Lines read() {
  mcap::Limits limits;
  limits.chunk_bytes = 16 << 20;
  mcap::Reader reader(path(), limits);
  Lines ordered = lines(reader.messages());
  (void)lines(reader.messages({95, 98, {{1}}}));
  for (const auto& index : reader.attachments()) {
    try {
      (void)reader.read(index);
    } catch (const lot::Error&) {
      // It says that it is not there.
    }
  }
  mcap::Stream stream(path(), limits);
  Lines in_file = lines(stream);
  if (reader.has_summary() && !reader.damage().any() && !stream.damage().any()) {
    require(ordered.size() <= in_file.size(), "an index that invents messages");
  }
  return in_file;
}

/// All that is in `part` is in `whole`.
bool is_part_of(const Lines& part, const Lines& whole) {
  return std::ranges::all_of(
      part, [&](const std::string& l) { return std::ranges::find(whole, l) != whole.end(); });
}

void check_whole(const Lines& expected) {
  require(read() == expected, "a file that was not changed");
  mcap::Reader reader(path());
  require(reader.has_summary() && reader.statistics().messages == expected.size(), "its summary");
  require(mcap::recover(path()).was_whole, "the recovery of a whole file");
}

/// `certain`: whatever was changed, a CRC covers each message.
void check_edited(const Lines& expected, bool certain) {
  try {
    const Lines seen = read();
    if (certain) require(is_part_of(seen, expected), "a message that was not written");
    const auto recovered = mcap::recover(path());
    if (planted("lost_summary")) std::filesystem::resize_file(path(), 60);
    if (recovered.was_whole) return;
    require(mcap::recover(path()).was_whole, "a recovered file");
    mcap::Reader reader(path());
    require(is_part_of(seen, lines(reader.messages())), "the messages of a recovered file");
  } catch (const lot::Error&) {
    // It is no recording any more, and says so.
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Bytes bytes(data, size);
  bool crcs = false;
  const Lines expected = write(bytes, crcs);
  const unsigned changed = edit(bytes);
  if (changed == 0) {
    check_whole(expected);
  } else {
    check_edited(expected, crcs && changed == 1);
  }
  return 0;
}
