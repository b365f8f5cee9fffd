// SPDX-License-Identifier: Apache-2.0

// The bytes of recordings: CRCs, compression, and a tiny file that was put together by hand.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "mcap/compression.hpp"
#include "mcap/contents.hpp"
#include "mcap/crc.hpp"
#include "mcap/recordings.hpp"
#include "mcap/records.hpp"
#include "mcap/writer.hpp"

using namespace lot;
using namespace lot::testing;
using mcap::Compression;

namespace {

/// Bytes from hexadecimal digits; spaces between them do not count.
std::string hex(const std::string& digits) {
  std::string bytes;
  for (std::size_t i = 0; i + 1 < digits.size(); ++i) {
    if (digits[i] == ' ') continue;
    bytes.push_back(static_cast<char>(std::stoi(digits.substr(i++, 2), nullptr, 16)));
  }
  return bytes;
}

const std::string kMagic = hex("89 4d 43 41 50 30 0d 0a");

/// Up to the end of the message index: 204 bytes.
std::string golden_data() {
  return kMagic +
         // Header: profile "p", library "l"
         hex("01 0a00000000000000 01000000 70 01000000 6c") +
         // Schema 1 "S", encoding "e", data "d"
         hex("03 1100000000000000 0100 01000000 53 01000000 65 01000000 64") +
         // Channel 1 of schema 1, "/t", encoding "e", metadata k: v
         hex("04 1d00000000000000 0100 0100 02000000 2f74 01000000 65"
             "0a000000 01000000 6b 01000000 76") +
         // Chunk: times 5 and 5, 33 bytes, no CRC, no compression, 33 bytes
         hex("06 4900000000000000 0500000000000000 0500000000000000 2100000000000000 00000000"
             "00000000 2100000000000000") +
         // in it: Message of channel 1, sequence 2, times 5 and 4, "hi"
         hex("05 1800000000000000 0100 02000000 0500000000000000 0400000000000000 6869") +
         // MessageIndex of channel 1: time 5 at offset 0
         hex("07 1600000000000000 0100 10000000 0500000000000000 0000000000000000");
}

/// DataEnd and the summary of golden_data().
std::string golden_end() {
  return hex("0f 0400000000000000 00000000") +
         // at 0xd9: Schema, at 0xf3: Channel, as above
         hex("03 1100000000000000 0100 01000000 53 01000000 65 01000000 64") +
         hex("04 1d00000000000000 0100 0100 02000000 2f74 01000000 65"
             "0a000000 01000000 6b 01000000 76") +
         // at 0x119: Statistics: 1 message, schema, channel; no attachment, metadata; 1 chunk
         hex("0b 3800000000000000 0100000000000000 0100 01000000 00000000 00000000 01000000"
             "0500000000000000 0500000000000000 0a000000 0100 0100000000000000") +
         // at 0x15a: ChunkIndex: times, the chunk at 0x5b with 82 bytes, its index at 0xad
         hex("08 4a00000000000000 0500000000000000 0500000000000000 5b00000000000000"
             "5200000000000000 0a000000 0100 ad00000000000000 1f00000000000000 00000000"
             "2100000000000000 2100000000000000");
}

}  // namespace

TEST_CASE("a recording has the bytes that were put together by hand") {
  const Directory directory;
  mcap::WriterOptions options;
  options.header = {"p", "l"};
  options.crcs = false;
  mcap::Writer writer(directory.file(), options);
  const mcap::Bytes data{std::byte{'d'}};
  const auto schema = writer.add(mcap::Schema{0, "S", "e", data});
  const auto channel = writer.add(mcap::Channel{0, schema, "/t", "e", {{"k", "v"}}});
  put(writer, {channel, 2, 5, 4}, "hi");
  writer.flush();
  CHECK(read_file(directory.file()) == golden_data());
  writer.close();

  const std::string bytes = read_file(directory.file());
  const std::string begin = golden_data() + golden_end();
  REQUIRE(bytes.size() > begin.size());
  CHECK(bytes.substr(0, begin.size()) == begin);
  const std::uint64_t summary = golden_data().size() + 13;
  const std::uint64_t offsets = begin.size();
  // Four groups: opcode, place and length of each; then the footer.
  const auto number = [&](std::size_t at) {
    std::uint64_t n = 0;
    std::memcpy(&n, bytes.data() + at, sizeof(n));
    return n;
  };
  const std::uint64_t groups[4][3] = {
      {3, summary, 26}, {4, summary + 26, 38}, {11, summary + 64, 65}, {8, summary + 129, 83}};
  for (std::size_t i = 0; i < 4; ++i) {
    const std::size_t at = offsets + 26 * i;
    CHECK(bytes[at] == 14);
    CHECK(number(at + 1) == 17);
    CHECK(static_cast<unsigned char>(bytes[at + 9]) == groups[i][0]);
    CHECK(number(at + 10) == groups[i][1]);
    CHECK(number(at + 18) == groups[i][2]);
  }
  const std::size_t footer = offsets + 104;
  CHECK(bytes.substr(footer, 9) == hex("02 1400000000000000"));
  CHECK(number(footer + 9) == summary);
  CHECK(number(footer + 17) == offsets);
  CHECK(bytes.substr(footer + 25) == hex("00000000") + kMagic);
}

TEST_CASE("a CRC is that of zlib, and that of two pieces follows from theirs") {
  CHECK(mcap::Crc(view("123456789")).value() == 0xcbf43926);
  CHECK(mcap::Crc(view("")).value() == 0);
  const std::string bytes = payload(7, 100000);
  const std::uint32_t whole = mcap::Crc(view(bytes)).value();
  for (const std::size_t cut : {0u, 1u, 2u, 255u, 256u, 65536u, 99999u, 100000u}) {
    const std::string_view all = bytes;
    mcap::Crc crc(view(all.substr(0, cut)));
    crc.add(mcap::Crc(view(all.substr(cut))));
    CHECK(crc.value() == whole);
  }
}

TEST_CASE("what is compressed in pieces is uncompressed as a whole") {
  for (const auto compression : {Compression::Lz4, Compression::Zstd}) {
    mcap::Compressor compressor(compression, 0);
    for (const std::size_t size : {0u, 1u, 100u, 70000u, 9000000u}) {
      const std::string bytes = payload(size, size);
      const std::string_view all = bytes;
      const std::vector<mcap::View> pieces{view(all.substr(0, size / 3)),
                                           view(all.substr(size / 3, 1)),
                                           view(all.substr(std::min(size, size / 3 + 1)))};
      const mcap::View frame = compressor.compress(pieces);
      CHECK(mcap::most_uncompressed(compression, frame.size()) >= size);
      mcap::Buffer back(size);
      mcap::uncompress(compression, frame, back.bytes());
      CHECK(text(back.bytes()) == bytes);
      mcap::Buffer longer(size + 1);
      CHECK_THROWS_AS(mcap::uncompress(compression, frame, longer.bytes()), mcap::Malformed);
      if (size == 0) continue;
      mcap::Buffer shorter(size - 1);
      CHECK_THROWS_AS(mcap::uncompress(compression, frame, shorter.bytes()), mcap::Malformed);
      const mcap::View cut = frame.first(frame.size() - 1);
      CHECK_THROWS_AS(mcap::uncompress(compression, cut, back.bytes()), mcap::Malformed);
    }
  }
}

TEST_CASE("64 MiB of zeros stay within what their compressed bytes can give") {
  const std::string zeros(64 << 20, '\0');
  const mcap::View piece = view(zeros);
  for (const auto compression : {Compression::Lz4, Compression::Zstd}) {
    mcap::Compressor compressor(compression, compression == Compression::Zstd ? 19 : 12);
    const mcap::View frame = compressor.compress(std::span(&piece, 1));
    CHECK(mcap::most_uncompressed(compression, frame.size()) >= zeros.size());
  }
}

TEST_CASE("each record comes back from its bytes, with and without bytes behind it") {
  const auto body = [](mcap::Bytes record, bool padded) {
    record.erase(record.begin(), record.begin() + mcap::kPrefixBytes);
    if (padded) record.push_back(std::byte{1});
    return record;
  };
  for (const bool padded : {false, true}) {
    mcap::Bytes out;
    const mcap::Channel channel{7, 8, "/topic", "cdr", {{"a", "b"}, {"c", ""}}};
    encode(out, channel);
    CHECK(mcap::decode<mcap::Channel>(body(out, padded)) == channel);
    out.clear();
    mcap::Statistics statistics{9, 1, 2, 3, 4, 5, 6, 7, {{1, 2}, {3, 4}}};
    encode(out, statistics);
    const auto counts = mcap::decode<mcap::Statistics>(body(out, padded));
    CHECK(counts.messages == 9);
    CHECK(counts.end == 7);
    CHECK(counts.channel_messages == statistics.channel_messages);
    out.clear();
    encode(out, mcap::Attachment{1, 2, "name", "type", {std::byte{3}}}, true);
    const mcap::Bytes attached = body(out, padded);
    CHECK(mcap::decode<mcap::Attachment>(attached).name == "name");
    mcap::Bytes changed = attached;
    changed[20] ^= std::byte{1};
    CHECK_THROWS_AS(mcap::decode<mcap::Attachment>(changed), mcap::Malformed);
  }
  for (std::size_t size = 0; size < 8; ++size) {
    CHECK_THROWS_AS(mcap::decode<mcap::Header>(mcap::Bytes(size, std::byte{1})), mcap::Malformed);
  }
}
