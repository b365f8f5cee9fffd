// SPDX-License-Identifier: Apache-2.0

// The bytes of recordings: CRCs, compression, and a tiny file that was put together by hand.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <type_traits>
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

TEST_CASE("each record has the bytes that the format says, and is the same from them") {
  const auto body_of = [](const mcap::Bytes& record) {
    return mcap::View(record).subspan(mcap::kPrefixBytes);
  };
  const auto check = [&](const auto& record, const std::string& digits) {
    using Record = std::decay_t<decltype(record)>;
    CAPTURE(digits);
    mcap::Bytes out;
    encode(out, record);
    CHECK(text(out) == hex(digits));
    const mcap::View body = body_of(out);
    mcap::Bytes again;
    encode(again, mcap::decode<Record>(body));
    CHECK(text(again) == hex(digits));
    for (std::size_t size = 0; size < body.size(); ++size) {
      CAPTURE(size);
      CHECK_THROWS_WITH_AS(mcap::decode<Record>(body.first(size)), "it ends too early",
                           mcap::Malformed);
    }
  };
  check(mcap::Header{"pr", "lib"}, "01 0d00000000000000 02000000 7072 03000000 6c6962");
  check(mcap::Header{}, "01 0800000000000000 00000000 00000000");
  check(mcap::Footer{0x0102030405060708, 0x1112131415161718, 0x21222324},
        "02 1400000000000000 0807060504030201 1817161514131211 24232221");
  check(mcap::Schema{0x0102, "n", "en", {std::byte{7}, std::byte{8}, std::byte{9}}},
        "03 1400000000000000 0201 01000000 6e 02000000 656e 03000000 070809");
  check(mcap::Channel{0x0102, 0x0304, "t", "me", {{"a", "bc"}, {"d", ""}}},
        "04 2700000000000000 0201 0403 01000000 74 02000000 6d65 14000000 01000000 61 02000000 "
        "6263 01000000 64 00000000");
  check(mcap::MessageIndex{0x0102, {{3, 4}, {5, 6}}},
        "07 2600000000000000 0201 20000000 0300000000000000 0400000000000000 0500000000000000 "
        "0600000000000000");
  check(mcap::MessageIndex{1, {}}, "07 0600000000000000 0100 00000000");
  check(mcap::ChunkIndex{1, 2, 3, 4, {{5, 6}, {7, 8}, {7, 9}}, 10, "lz4", 11, 12},
        "08 6100000000000000 0100000000000000 0200000000000000 0300000000000000 0400000000000000 "
        "1e000000 0500 0600000000000000 0700 0800000000000000 0700 0900000000000000 "
        "0a00000000000000 03000000 6c7a34 0b00000000000000 0c00000000000000");
  check(mcap::AttachmentIndex{1, 2, 3, 4, 5, "n", "me"},
        "0a 3300000000000000 0100000000000000 0200000000000000 0300000000000000 0400000000000000 "
        "0500000000000000 01000000 6e 02000000 6d65");
  check(mcap::Statistics{1, 2, 3, 4, 5, 6, 7, 8, {{9, 10}, {11, 12}}},
        "0b 4200000000000000 0100000000000000 0200 03000000 04000000 05000000 06000000 "
        "0700000000000000 0800000000000000 14000000 0900 0a00000000000000 0b00 0c00000000000000");
  check(mcap::Metadata{"nam", {{"k", "v"}}},
        "0c 1500000000000000 03000000 6e616d 0a000000 01000000 6b 01000000 76");
  check(mcap::MetadataIndex{1, 2, "nam"},
        "0d 1700000000000000 0100000000000000 0200000000000000 03000000 6e616d");

  mcap::Bytes out;
  encode(out, mcap::SummaryOffset{mcap::Opcode::Channel, 1, 2});
  CHECK(text(out) == hex("0e 1100000000000000 04 0100000000000000 0200000000000000"));
  out.clear();
  mcap::encode_data_end(out, 0x01020304);
  CHECK(text(out) == hex("0f 0400000000000000 04030201"));
  out.clear();
  mcap::encode_magic(out);
  CHECK(text(out) == kMagic);
}

TEST_CASE("an attachment's CRC covers all but its record's prefix, and none is asked for by 0") {
  const mcap::Attachment attachment{1, 2, "n", "me", {std::byte{5}, std::byte{6}}};
  const std::string covered =
      hex("0100000000000000 0200000000000000 01000000 6e 02000000 6d65 0200000000000000 0506");
  for (const bool crc : {true, false}) {
    CAPTURE(crc);
    mcap::Bytes out{std::byte{0x55}};  // what was there stays, and counts for nothing
    encode(out, attachment, crc);
    const std::uint32_t value = crc ? mcap::Crc(view(covered)).value() : 0;
    std::string expected = hex("55 09 2900000000000000") + covered;
    expected.append(reinterpret_cast<const char*>(&value), sizeof(value));
    CHECK(text(out) == expected);
    const std::string whole = expected.substr(1 + mcap::kPrefixBytes);
    const auto back = mcap::decode<mcap::Attachment>(view(whole));
    CHECK(back.log_time == 1);
    CHECK(back.create_time == 2);
    CHECK(back.name == "n");
    CHECK(back.media_type == "me");
    CHECK(text(back.data) == hex("0506"));
    for (std::size_t size = 0; size < whole.size(); ++size) {
      CAPTURE(size);
      CHECK_THROWS_WITH_AS(mcap::decode<mcap::Attachment>(view(whole.substr(0, size))),
                           "it ends too early", mcap::Malformed);
    }
    for (std::size_t at = 0; at < covered.size(); ++at) {
      if (!crc || (at >= 16 && at < 35)) continue;  // lengths: it may end too early
      CAPTURE(at);
      std::string changed = whole;
      changed[at] = static_cast<char>(changed[at] ^ 1);
      CHECK_THROWS_WITH_AS(mcap::decode<mcap::Attachment>(view(changed)), "its CRC is wrong",
                           mcap::Malformed);
    }
  }
}

TEST_CASE("the head of a message and that of a chunk say what follows them") {
  mcap::Bytes out;
  encode(out, mcap::MessageHead{0x0102, 3, 4, 5}, 7);
  CHECK(text(out) == hex("05 1d00000000000000 0201 03000000 0400000000000000 0500000000000000"));
  const mcap::View message = mcap::View(out).subspan(mcap::kPrefixBytes);
  const auto head = mcap::decode<mcap::MessageHead>(message);
  CHECK(head.channel == 0x0102);
  CHECK(head.sequence == 3);
  CHECK(head.log_time == 4);
  CHECK(head.publish_time == 5);
  for (std::size_t size = 0; size < message.size(); ++size) {
    CHECK_THROWS_AS(mcap::decode<mcap::MessageHead>(message.first(size)), mcap::Malformed);
  }

  for (const std::string& name : {std::string(), std::string("zstd")}) {
    CAPTURE(name);
    mcap::Bytes chunk;
    encode(chunk, mcap::ChunkHead{1, 2, 3, 4, name, 5});
    const std::string rest = name.empty() ? "00000000" : "04000000 7a737464";
    const std::string length = name.empty() ? "2d" : "31";
    CHECK(text(chunk) == hex("06 " + length +
                             "00000000000000 0100000000000000 0200000000000000 "
                             "0300000000000000 04000000 " +
                             rest + " 0500000000000000"));
    mcap::Bytes padded = chunk;
    padded.resize(chunk.size() + 5);
    const mcap::View body = mcap::View(padded).subspan(mcap::kPrefixBytes);
    const std::size_t taken = body.size() - 5;
    for (const std::size_t there : {taken, taken + 1, body.size()}) {
      CAPTURE(there);
      const auto [back, bytes] = mcap::decode_chunk_head(body.first(there), body.size());
      CHECK(bytes == taken);
      CHECK(back.start == 1);
      CHECK(back.end == 2);
      CHECK(back.uncompressed_bytes == 3);
      CHECK(back.uncompressed_crc == 4);
      CHECK(back.compression == name);
      CHECK(back.compressed_bytes == 5);
    }
    CHECK(mcap::decode_chunk_head(body, body.size() + 1).second == taken);
    CHECK_THROWS_WITH_AS(mcap::decode_chunk_head(body, body.size() - 1),
                         "its records are longer than it", mcap::Malformed);
    for (std::size_t size = 0; size < taken; ++size) {
      CHECK_THROWS_WITH_AS(mcap::decode_chunk_head(body.first(size), body.size()),
                           "it ends too early", mcap::Malformed);
    }
  }
}

TEST_CASE("a schema has no number 0, and of two values of one key the last one stays") {
  mcap::Bytes out;
  encode(out, mcap::Schema{});
  CHECK_THROWS_WITH_AS(mcap::decode<mcap::Schema>(mcap::View(out).subspan(mcap::kPrefixBytes)),
                       "it has the number 0, which means none", mcap::Malformed);
  const auto twice = mcap::decode<mcap::Metadata>(
      view(hex("00000000 14000000 01000000 6b 01000000 31 01000000 6b 01000000 32")));
  CHECK(twice.pairs == mcap::Pairs{{"k", "2"}});
  const auto counts = mcap::decode<mcap::Statistics>(
      view(std::string(42, '\0') + hex("14000000 0100 0200000000000000 0100 0300000000000000")));
  CHECK(counts.channel_messages.size() == 1);
  // A list whose last entry is cut off.
  CHECK_THROWS_AS(mcap::decode<mcap::Metadata>(view(hex("00000000 05000000 01000000 6b"))),
                  mcap::Malformed);
}

TEST_CASE("statistics count messages of each channel, the first time and the last one") {
  mcap::Statistics counts;
  const auto check = [&](std::uint64_t start, std::uint64_t end, std::uint64_t messages,
                         const std::map<std::uint16_t, std::uint64_t>& channels) {
    CHECK(counts.start == start);
    CHECK(counts.end == end);
    CHECK(counts.messages == messages);
    CHECK(counts.channel_messages == channels);
  };
  check(0, 0, 0, {});
  counts.count(7, 50);
  check(50, 50, 1, {{7, 1}});
  counts.count(8, 60);
  check(50, 60, 2, {{7, 1}, {8, 1}});
  counts.count(7, 40);
  check(40, 60, 3, {{7, 2}, {8, 1}});
  counts.count(7, 45);
  check(40, 60, 4, {{7, 3}, {8, 1}});
  CHECK(counts.schemas == 0);
  CHECK(counts.channels == 0);
  CHECK(counts.chunks == 0);
}

TEST_CASE("a writer of bytes measures what it was given, and a reader of bytes stops behind it") {
  mcap::Bytes out{std::byte{1}};
  mcap::Encoder to(out);
  to.number(std::uint16_t{0x0203});
  to.text("ab");
  to.list([&] { to.number(std::uint8_t{4}); });
  to.record(9, [&] { to.text(""); });
  CHECK(text(out) == hex("01 0302 02000000 6162 01000000 04 09 0400000000000000 00000000"));
  mcap::Decoder from(out);
  CHECK(from.left() == 27);
  CHECK(from.number<std::uint8_t>() == 1);
  CHECK(from.number<std::uint16_t>() == 0x0203);
  CHECK(from.text() == "ab");
  CHECK(from.list().size() == 1);
  CHECK(from.left() == 13);
  CHECK_THROWS_WITH_AS(from.raw(14), "it ends too early", mcap::Malformed);
  CHECK(from.left() == 13);
  CHECK(from.raw(13).size() == 13);
  CHECK(from.left() == 0);
  CHECK(from.raw(0).empty());
  const mcap::View pieces[] = {view("abc"), view(""), view("de")};
  CHECK(mcap::size_of(pieces) == 5);
}

TEST_CASE("compression is called by a name, and bounds what its bytes can stand for") {
  CHECK(mcap::name_of(Compression::None) == "");
  CHECK(mcap::name_of(Compression::Lz4) == "lz4");
  CHECK(mcap::name_of(Compression::Zstd) == "zstd");
  CHECK(mcap::compression_of("") == Compression::None);
  CHECK(mcap::compression_of("lz4") == Compression::Lz4);
  CHECK(mcap::compression_of("zstd") == Compression::Zstd);
  CHECK_THROWS_WITH_AS(mcap::compression_of("lz"), "its compression is not known: lz",
                       mcap::Malformed);
  const std::string letters = "abcdefghijklmnopqrstuvwxyz0123456789";
  const std::string cut = "its compression is not known: " + letters.substr(0, 32);
  CHECK_THROWS_WITH_AS(mcap::compression_of(letters), cut.c_str(), mcap::Malformed);
  constexpr std::uint64_t kMost = ~std::uint64_t{0};
  const struct {
    Compression compression;
    std::uint64_t compressed;
    std::uint64_t most;
  } bounds[] = {
      {Compression::None, 0, 0},
      {Compression::None, kMost, kMost},
      {Compression::Lz4, 0, 0},
      {Compression::Lz4, 1, 255},
      {Compression::Lz4, kMost / 255, kMost},
      {Compression::Lz4, kMost / 255 - 1, kMost - 255},
      {Compression::Lz4, kMost / 255 + 1, kMost},
      {Compression::Zstd, 1, 32768},
      {Compression::Zstd, 3, 98304},
      {Compression::Zstd, kMost / 32768, kMost - 32767},
      {Compression::Zstd, kMost / 32768 + 1, kMost},
  };
  for (const auto& [compression, compressed, most] : bounds) {
    CAPTURE(compressed);
    CHECK(mcap::most_uncompressed(compression, compressed) == most);
  }
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
