// SPDX-License-Identifier: Apache-2.0

// What a Stream and a Reader make of files: by time and channel, in order, of other writers, cut
// off, damaged and forged.

#include "mcap/reader.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "mcap/contents.hpp"
#include "mcap/recordings.hpp"
#include "mcap/recover.hpp"
#include "mcap/writer.hpp"
#include "support/error_of.hpp"
#include "support/seed.hpp"

using namespace lot;
using namespace lot::testing;
using mcap::Compression;

namespace {

/// A file that is put together record by record, right or wrong.
class Forge {
 public:
  Forge() {
    mcap::encode_magic(bytes_);
    encode(bytes_, mcap::Header{"", "forge"});
  }
  template <class Record>
  Forge& add(const Record& record) {
    encode(bytes_, record);
    return *this;
  }
  Forge& add(const mcap::MessageHead& head, std::string_view payload) {
    encode(bytes_, head, payload.size());
    return raw(payload);
  }
  Forge& raw(std::string_view bytes) {
    mcap::Encoder(bytes_).raw(view(bytes));
    return *this;
  }
  Forge& record(std::uint8_t opcode, std::string_view body) {
    mcap::Encoder(bytes_).record(opcode, [&] { raw(body); });
    return *this;
  }
  /// A chunk of these records.
  Forge& chunk(mcap::ChunkHead head, std::string_view records) {
    head.compressed_bytes = records.size();
    encode(bytes_, head);
    return raw(records);
  }
  Forge& end() {
    mcap::encode_data_end(bytes_, 0);
    encode(bytes_, mcap::Footer{});
    mcap::encode_magic(bytes_);
    return *this;
  }
  std::string text() const { return lot::testing::text(bytes_); }

 private:
  mcap::Bytes bytes_;
};

/// The records of a chunk with a message.
std::string records_of(const mcap::Channel& channel, const mcap::MessageHead& head) {
  mcap::Bytes out;
  encode(out, channel);
  encode(out, head, 1);
  return text(out) + "x";
}

mcap::ChunkHead head_of(const std::string& records) {
  return {1, 1, records.size(), mcap::Crc(view(records)).value(), "", 0};
}

/// A recording with all kinds of records, as small as may be.
std::string small_file(const std::string& path, Compression compression, bool crcs) {
  std::filesystem::remove(path);
  mcap::WriterOptions options;
  options.compression = compression;
  options.crcs = crcs;
  options.chunk_bytes = 100;
  mcap::Writer writer(path, options);
  const auto schema = writer.add(mcap::Schema{0, "S", "e", {std::byte{1}}});
  for (const char* topic : {"/a", "/b"}) writer.add(mcap::Channel{0, schema, topic, "", {}});
  for (unsigned i = 0; i < 6; ++i) {
    put(writer, {static_cast<std::uint16_t>(1 + i % 2), i, 10 + i, i},
        i == 4 ? payload(i, 150) : "m");
  }
  writer.add(mcap::Attachment{1, 2, "n", "t", {std::byte{1}}});
  writer.add(mcap::Metadata{"m", {{"k", "v"}}});
  writer.close();
  return read_file(path);
}

/// All that there is to see of a file, by each reader. Each may throw lot::Error, and nothing else.
void look_at(const std::string& path, std::vector<std::string>& seen, bool& damaged) {
  seen.clear();
  damaged = false;
  try {
    mcap::Stream stream(path);
    seen = lines(stream);
    damaged = stream.damage().any() || !stream.is_whole();
    mcap::Reader reader(path);
    (void)lines(reader.messages());
    for (const auto& index : reader.attachments()) (void)reader.read(index);
    for (const auto& index : reader.metadata()) (void)reader.read(index);
    damaged = damaged || reader.damage().any() || !reader.has_summary();
  } catch (const Error&) {
    damaged = true;
  }
}

/// LOT_TEST_ONE_IN: of what is done at each byte of a file, a share, another one with each seed.
Share share() {
  const char* said = std::getenv("LOT_TEST_ONE_IN");
  constexpr unsigned kMost = 16;  // the last byte of a message is found before the file's end
  const auto one_in = said == nullptr ? 1 : std::strtoul(said, nullptr, 10);
  return Share(std::clamp(static_cast<unsigned>(one_in), 1U, kMost));
}

bool is_begin_of(const std::vector<std::string>& part, const std::vector<std::string>& whole) {
  return part.size() <= whole.size() && std::equal(part.begin(), part.end(), whole.begin());
}

}  // namespace

TEST_CASE("a Reader gives messages by log time, across chunks that overlap") {
  const Directory directory;
  mcap::WriterOptions options;
  options.chunk_bytes = 200;
  mcap::Writer writer(directory.file(), options);
  for (const char* topic : {"/a", "/b", "/c"}) writer.add(mcap::Channel{0, 0, topic, "", {}});
  std::vector<std::pair<std::uint64_t, std::uint32_t>> all;
  for (unsigned i = 0; i < 300; ++i) {
    const std::uint64_t time = 1000 + i * 10 - i * 7919 % 97 * 3;
    put(writer, {static_cast<std::uint16_t>(1 + i % 3), i, time, 0}, payload(i, i % 40));
    all.emplace_back(time, i);
  }
  writer.close();
  std::sort(all.begin(), all.end());  // of equal times, in the order of the file

  mcap::Reader reader(directory.file());
  const auto check = [&](const mcap::Query& query, auto&& wanted) {
    auto messages = reader.messages(query);
    for (const auto& [time, sequence] : all) {
      if (!wanted(time, sequence)) continue;
      const auto message = messages.next();
      REQUIRE(message);
      REQUIRE(message->head.sequence == sequence);
      REQUIRE(text(message->payload) == payload(sequence, sequence % 40));
    }
    CHECK_FALSE(messages.next());
  };
  check({}, [](auto...) { return true; });
  check({1500, 2000, {}}, [](auto time, auto) { return time >= 1500 && time <= 2000; });
  check({0, 1800, {{2}}}, [](auto time, auto n) { return time <= 1800 && n % 3 == 1; });
  check({0, std::numeric_limits<std::uint64_t>::max(), {{1, 3, 77}}},
        [](auto, auto n) { return n % 3 != 1; });
  check({50000, 60000, {}}, [](auto...) { return false; });
  check({0, 9, {std::set<std::uint16_t>{}}}, [](auto...) { return false; });
}

TEST_CASE("files without chunks and summary, with unknown records, are read") {
  const Directory directory;
  const mcap::Channel channel{5, 0, "/t", "", {}};
  write_file(directory.file(), Forge()
                                   .record(0x7f, "unknown")
                                   .add(channel)
                                   .add({5, 1, 30, 0}, "late")
                                   .record(0xff, "")
                                   .add({5, 2, 20, 0}, "early")
                                   .end()
                                   .text());
  const std::vector<std::string> in_file{"5 1 30 0 late", "5 2 20 0 early"};
  mcap::Stream stream(directory.file());
  CHECK(lines(stream) == in_file);
  CHECK(stream.is_whole());
  CHECK_FALSE(stream.damage().any());
  mcap::Reader reader(directory.file());
  CHECK_FALSE(reader.has_summary());
  CHECK_FALSE(reader.damage().any());
  CHECK(lines(reader.messages()) == std::vector<std::string>{in_file[1], in_file[0]});
  CHECK(reader.statistics().messages == 2);
}

TEST_CASE("what a chunk says wrong skips it as a whole, and is counted") {
  const mcap::Channel channel{1, 0, "/t", "", {}};
  const std::string good = records_of(channel, {1, 0, 1, 0});
  const auto good_head = head_of(good);
  mcap::ChunkHead wrong_crc = good_head;
  wrong_crc.uncompressed_crc ^= 1;
  mcap::ChunkHead unknown = good_head;
  unknown.compression = "bz2";
  mcap::ChunkHead bomb = good_head;
  bomb.compression = "zstd";
  bomb.uncompressed_bytes = std::uint64_t{1} << 40;
  mcap::ChunkHead longer = good_head;
  ++longer.uncompressed_bytes;
  mcap::ChunkHead shorter = good_head;
  --shorter.uncompressed_bytes;
  mcap::ChunkHead unpacked = good_head;
  unpacked.compression = "lz4";
  mcap::Bytes nested;
  encode(nested, mcap::Footer{});
  const std::string footer = text(nested);
  const std::string short_message = std::string("\x05\x02\0\0\0\0\0\0\0xx", 11);
  const std::string forged_length = std::string("\x05\xff\xff\xff\xff\xff\xff\xff\xff", 9) + good;

  const auto check = [&](const mcap::ChunkHead& head, const std::string& records, const char* why) {
    const Directory directory;
    const std::string later = records_of(channel, {1, 7, 2, 0});
    write_file(directory.file(),
               Forge().chunk(head, records).chunk(head_of(later), later).end().text());
    mcap::Stream stream(directory.file());
    CHECK(lines(stream) == std::vector<std::string>{"1 7 2 0 x"});
    CHECK(stream.damage().chunks == 1);
    CHECK(stream.damage().bytes ==
          Forge().chunk(head, records).text().size() - Forge().text().size());
    CHECK(names(stream.damage().first, why));
    mcap::Reader reader(directory.file());
    CHECK(lines(reader.messages()) == std::vector<std::string>{"1 7 2 0 x"});
    CHECK(reader.damage().chunks == 1);
  };
  check(wrong_crc, good, "CRC is wrong");
  check(unknown, good, "compression is not known: bz2");
  check(bomb, good, "larger than");
  check(longer, good, "larger than its data can be");
  check(shorter, good, "two sizes");
  check(unpacked, good, "lz4 cannot uncompress");
  check(head_of(footer), footer, "may not be in a chunk");
  check(head_of(short_message), short_message, "ends too early");
  check(head_of(forged_length), forged_length, "ends too early");
}

TEST_CASE("messages without a channel, and channels with two meanings, are counted") {
  const Directory directory;
  const std::string records = records_of({1, 0, "/t", "", {}}, {1, 0, 1, 0});
  write_file(directory.file(), Forge()
                                   .add({9, 0, 1, 0}, "lost")
                                   .chunk(head_of(records), records)
                                   .add(mcap::Channel{1, 0, "/other", "", {}})
                                   .end()
                                   .text());
  mcap::Stream stream(directory.file());
  CHECK(lines(stream) == std::vector<std::string>{"1 0 1 0 x"});
  CHECK(stream.damage().records == 2);
  CHECK(stream.channels().at(1).topic == "/t");
}

TEST_CASE("what is no recording is an error that names it") {
  const Directory directory;
  const auto check = [&](const std::string& bytes, const char* what) {
    write_file(directory.file(), bytes);
    for (const auto& error : {error_of([&] { mcap::Stream(directory.file()); }),
                              error_of([&] { mcap::Reader(directory.file()); }),
                              error_of([&] { mcap::recover(directory.file()); })}) {
      CHECK(error.first == EINVAL);
      CHECK(names(error.second, what));
      CHECK(names(error.second, "a.mcap"));
    }
    CHECK(read_file(directory.file()) == bytes);
  };
  check("", "is empty");
  check("#ROSBAG V2.0", "not an MCAP file");
  check(Forge().text().substr(0, 20), "no header");
  CHECK(error_of([&] { mcap::Stream(directory.file("none")); }).first == ENOENT);
  CHECK(error_of([&] { mcap::Stream("/tmp"); }).first == EINVAL);
  CHECK(error_of([&] { mcap::Stream("/dev/zero"); }).first == EINVAL);
}

TEST_CASE("a forged summary leads nowhere: the file is read") {
  const Directory directory;
  const std::string whole = small_file(directory.file(), Compression::None, false);
  const auto messages = lines(mcap::Reader(directory.file()).messages());
  const std::size_t footer = whole.size() - 8 - 20;
  std::uint64_t summary = 0;
  std::memcpy(&summary, whole.data() + footer, sizeof(summary));
  for (const std::uint64_t forged :
       {std::uint64_t{0}, std::uint64_t{8}, summary - 13, summary + 1, std::uint64_t{whole.size()},
        std::numeric_limits<std::uint64_t>::max()}) {
    std::string bytes = whole;
    std::memcpy(bytes.data() + footer, &forged, sizeof(forged));
    write_file(directory.file(), bytes);
    mcap::Reader reader(directory.file());
    CHECK_FALSE(reader.has_summary());
    CHECK(reader.summary_fault().empty() == (forged == 0));  // 0: there is none
    CHECK(lines(reader.messages()) == messages);
  }
  std::string other_end = whole;
  other_end.back() = 'x';
  write_file(directory.file(), other_end);
  mcap::Reader unsigned_file(directory.file());
  CHECK_FALSE(unsigned_file.has_summary());
  CHECK(unsigned_file.summary_fault().empty());  // it was not closed
  CHECK(lines(unsigned_file.messages()) == messages);
  // The chunks' places in the index, moved: a reader skips what is not there.
  for (std::size_t at = summary; at < footer; ++at) {
    std::string bytes = whole;
    for (std::size_t i = at; i < std::min(at + 8, footer); ++i) bytes[i] = '\xff';
    write_file(directory.file(), bytes);
    std::vector<std::string> seen;
    bool damaged = false;
    look_at(directory.file(), seen, damaged);
    REQUIRE(is_begin_of(seen, messages));
  }
}

TEST_CASE("a file that is cut at any byte is read up to there, and recovered") {
  const Directory directory;
  for (const auto compression : {Compression::None, Compression::Zstd, Compression::Lz4}) {
    const std::string whole = small_file(directory.file(), compression, true);
    const auto messages = lines(mcap::Stream(directory.file()));
    std::size_t before = 0;
    for (std::size_t cut = 0; cut < whole.size(); ++cut) {
      if (!share().has(cut)) continue;
      write_file(directory.file(), whole.substr(0, cut));
      std::vector<std::string> seen;
      bool damaged = false;
      look_at(directory.file(), seen, damaged);
      REQUIRE(damaged);
      REQUIRE(is_begin_of(seen, messages));
      REQUIRE(seen.size() >= before);
      before = seen.size();
      if (cut < mcap::kMagicBytes + 17) continue;  // there is no header
      const auto recovered = mcap::recover(directory.file());
      REQUIRE(recovered.statistics.messages == seen.size());
      mcap::Reader reader(directory.file());
      REQUIRE(reader.has_summary());
      REQUIRE(lines(reader.messages()) == seen);
      for (const auto& chunk : reader.chunks()) REQUIRE(chunk.message_index_bytes != 0);
    }
    CHECK(before == messages.size());
  }
}

TEST_CASE("a byte that is changed anywhere is an error, skipped and counted, or what it says") {
  const Directory directory;
  for (const auto compression : {Compression::None, Compression::Zstd, Compression::Lz4}) {
    const std::string whole = small_file(directory.file(), compression, true);
    const auto messages = lines(mcap::Stream(directory.file()));
    for (std::size_t at = 0; at < whole.size(); ++at) {
      if (!share().has(at)) continue;
      for (const int change : {0x01, 0x80, 0xff}) {
        std::string bytes = whole;
        bytes[at] = static_cast<char>(bytes[at] ^ change);
        write_file(directory.file(), bytes);
        std::vector<std::string> seen;
        bool damaged = false;
        look_at(directory.file(), seen, damaged);
        // With CRCs no message is a wrong one; it may be missing, and then that is said.
        for (const auto& message : seen) {
          REQUIRE(std::find(messages.begin(), messages.end(), message) != messages.end());
        }
        if (seen.size() != messages.size()) REQUIRE(damaged);
      }
    }
  }
}

TEST_CASE("a file whose tail is zeros is read up to there") {
  const Directory directory;
  const std::string whole = small_file(directory.file(), Compression::None, true);
  const auto messages = lines(mcap::Stream(directory.file()));
  // Some of the zeros may belong to the record that they cut off.
  const std::string bytes = whole.substr(0, whole.size() / 2) + std::string(5000, '\0');
  write_file(directory.file(), bytes);
  mcap::Stream stream(directory.file());
  CHECK(is_begin_of(lines(stream), messages));
  CHECK(stream.damage().bytes > 4000);
  const auto recovered = mcap::recover(directory.file());
  CHECK(recovered.cut_bytes > 4000);
  CHECK(mcap::Reader(directory.file()).has_summary());
}

TEST_CASE("a Reader refuses more than its limits") {
  const Directory directory;
  mcap::WriterOptions options;
  options.chunk_bytes = 100;
  mcap::Writer writer(directory.file(), options);
  const auto channel = writer.add(mcap::Channel{0, 0, "/t", "", {}});
  for (unsigned i = 0; i < 3; ++i) put(writer, {channel, i, 10 - i, 0}, payload(i, 1000));
  writer.close();
  mcap::Limits limits;
  limits.chunk_bytes = 1000;
  mcap::Stream stream(directory.file(), limits);
  CHECK(lines(stream).empty());
  CHECK(stream.damage().chunks == 3);
  CHECK(names(stream.damage().first, "limit"));
}
