// SPDX-License-Identifier: Apache-2.0

// What a Writer writes when all goes well, and what it leaves when it does not: full disks, writes
// that fail or are interrupted, files that are there or go, kills.

#include "mcap/writer.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <sys/uio.h>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "mcap/reader.hpp"
#include "mcap/recordings.hpp"
#include "mcap/recover.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/seed.hpp"
#include "support/small_disk.hpp"

using namespace lot;
using namespace lot::testing;
using mcap::Compression;

namespace {

/// What the next calls of pwritev(2) do in place of their work.
struct Fault {
  unsigned shorts = 0;   ///< so many write a part only,
  std::size_t most = 0;  ///< of so many bytes;
  unsigned errors = 0;   ///< so many behind them fail
  int error = 0;
};
Fault fault;

}  // namespace

extern "C" ssize_t __real_pwritev(int fd, const iovec* pieces, int count, off_t at);
extern "C" ssize_t __wrap_pwritev(int fd, const iovec* pieces, int count, off_t at) {
  if (fault.shorts != 0) {
    --fault.shorts;
    iovec first = pieces[0];
    first.iov_len = std::min(first.iov_len, fault.most);
    return __real_pwritev(fd, &first, 1, at);
  }
  if (fault.errors != 0) {
    --fault.errors;
    errno = fault.error;
    return -1;
  }
  return __real_pwritev(fd, pieces, count, at);
}

namespace {

constexpr std::size_t kChunk = 4096;

mcap::WriterOptions options(Compression compression = Compression::None, bool crcs = true) {
  mcap::WriterOptions made;
  made.header = {"lot", "test"};
  made.compression = compression;
  made.chunk_bytes = kChunk;
  made.crcs = crcs;
  return made;
}

std::uint16_t add_channel(mcap::Writer& writer, const std::string& topic) {
  const auto schema = writer.add(mcap::Schema{0, "type of " + topic, "lot", {}});
  return writer.add(mcap::Channel{0, schema, topic, "lot", {{"topic", topic}}});
}

/// Messages of two channels, small ones and some that have a chunk of their own, as they should be
/// read.
std::vector<std::string> fill(mcap::Writer& writer, unsigned messages) {
  const std::uint16_t channels[] = {add_channel(writer, "/a"), add_channel(writer, "/b")};
  std::vector<std::string> expected;
  for (unsigned i = 0; i < messages; ++i) {
    const std::string bytes = payload(i, i % 7 == 3 ? 3 * kChunk : i % 5 * 100);
    const mcap::MessageHead head{channels[i % 2], i, 1000 + i, 900 + i};
    put(writer, head, bytes);
    expected.push_back(line({head, view(bytes)}));
  }
  return expected;
}

}  // namespace

TEST_CASE("what a Writer writes is read, with each compression, with and without CRCs") {
  for (const auto compression : {Compression::None, Compression::Lz4, Compression::Zstd}) {
    for (const bool crcs : {true, false}) {
      const Directory directory;
      mcap::Writer writer(directory.file(), options(compression, crcs));
      const auto expected = fill(writer, 200);
      writer.add(mcap::Attachment{1, 2, "notes.txt", "text/plain", mcap::Bytes(10000)});
      writer.add(mcap::Metadata{"machine", {{"host", "x"}}});
      writer.close();
      CHECK(writer.lost() == 0);
      CHECK(writer.bytes() == std::filesystem::file_size(directory.file()));

      mcap::Stream stream(directory.file());
      CHECK(lines(stream) == expected);
      CHECK(stream.is_whole());
      CHECK(stream.damage().first == "");
      mcap::Reader reader(directory.file());
      CHECK(reader.has_summary());
      CHECK(reader.header().profile == "lot");
      CHECK(lines(reader.messages()) == expected);
      CHECK(reader.damage().first == "");
      CHECK(reader.statistics().messages == 200);
      CHECK(reader.statistics().chunks == reader.chunks().size());
      CHECK(reader.channels().at(2).topic == "/b");
      CHECK(reader.schemas().at(2).name == "type of /b");
      REQUIRE(reader.attachments().size() == 1);
      CHECK(reader.read(reader.attachments()[0]).data.size() == 10000);
      CHECK(reader.read(reader.metadata().at(0)).pairs.at("host") == "x");
    }
  }
}

TEST_CASE("a Writer that is told nothing makes chunks of 1 MiB, by the usual level") {
  const Directory directory;
  const auto write = [&](const char* name, const mcap::WriterOptions& how) {
    mcap::Writer writer(directory.file(name), how);
    const auto channel = add_channel(writer, "/a");
    for (unsigned i = 0; i < 1200; ++i) put(writer, {channel, i, i, i}, payload(i, 1000));
    writer.close();
    CHECK(mcap::Reader(directory.file(name)).chunks().size() == 2);
    return read_file(directory.file(name));
  };
  mcap::WriterOptions untold;
  untold.compression = Compression::Zstd;
  mcap::WriterOptions usual = untold;
  usual.level = 0;
  CHECK(write("untold.mcap", untold) == write("usual.mcap", usual));
}

TEST_CASE("a large message has a chunk of its own, and comes in pieces") {
  const Directory directory;
  mcap::Writer writer(directory.file(), options());
  const auto channel = add_channel(writer, "/image");
  put(writer, {channel, 0, 1, 1}, "before");
  const std::string bytes = payload(1, 100000);
  std::vector<mcap::View> pieces;  // more than one pwritev takes
  for (std::size_t i = 0; i < bytes.size(); i += 50) pieces.push_back(view(bytes).subspan(i, 50));
  writer.write({channel, 1, 2, 2}, pieces);
  CHECK(writer.statistics().chunks == 2);
  put(writer, {channel, 2, 3, 3}, "behind");
  writer.close();
  const auto all = lines(mcap::Stream(directory.file()));
  REQUIRE(all.size() == 3);
  CHECK(all[1] == "1 1 2 2 " + bytes);
}

TEST_CASE("a message that fills a chunk is written at once, and a smaller one waits for others") {
  const Directory directory;
  mcap::Writer writer(directory.file(), options());
  const auto channel = add_channel(writer, "/a");
  constexpr std::size_t kHead = 9 + 22;  // of a record, and of a message
  put(writer, {channel, 0, 1, 1}, payload(1, kChunk - kHead));
  CHECK(writer.statistics().chunks == 1);
  put(writer, {channel, 1, 2, 2}, payload(2, kChunk - kHead - 1));
  CHECK(writer.statistics().chunks == 1);
  put(writer, {channel, 2, 3, 3}, "");
  CHECK(writer.statistics().chunks == 2);
  writer.close();
  CHECK(mcap::Reader(directory.file()).chunks().size() == 3);
}

TEST_CASE("a recording that is there is not overwritten, and one that is written has one writer") {
  const Directory directory;
  mcap::Writer writer(directory.file(), options());
  const auto second = error_of([&] { mcap::Writer(directory.file(), options()); });
  CHECK(second.first == EEXIST);
  CHECK(names(second.second, "never overwritten"));
  const auto recovery = error_of([&] { mcap::recover(directory.file()); });
  CHECK(recovery.first == EWOULDBLOCK);
  CHECK(names(recovery.second, "another process writes it"));
  writer.close();
  CHECK(mcap::recover(directory.file()).was_whole);
}

TEST_CASE("a Writer says what is wrong with a place, a channel, a schema") {
  const Directory directory;
  const auto gone = error_of([&] { mcap::Writer(directory.file("no/a.mcap"), options()); });
  CHECK(gone.first == ENOENT);
  CHECK(names(gone.second, "no/a.mcap"));
  mcap::Writer writer(directory.file(), options());
  CHECK(error_of([&] { put(writer, {1, 0, 0, 0}, ""); }).first == EINVAL);
  CHECK(error_of([&] { writer.add(mcap::Channel{0, 9, "/t", "", {}}); }).first == EINVAL);
  const auto channel = add_channel(writer, "/a");
  std::filesystem::remove(directory.file());
  put(writer, {channel, 0, 0, 0}, "x");
  const auto removed = error_of([&] { writer.flush(); });
  CHECK(removed.first == ENOENT);
  CHECK(names(removed.second, "removed while it was written"));
  CHECK(writer.lost() == 1);
  CHECK(error_of([&] { writer.close(); }).first == ENOENT);
  CHECK(error_of([&] { put(writer, {channel, 0, 0, 0}, "x"); }).first == EBADF);
}

TEST_CASE("a Writer goes on behind interrupted and short writes") {
  const Directory directory;
  mcap::Writer writer(directory.file(), options());
  fault = {0, 0, 3, EINTR};
  const auto expected = fill(writer, 20);
  fault = {5000, 1, 2, EINTR};
  writer.flush();
  writer.close();
  fault = {};
  CHECK(lines(mcap::Reader(directory.file()).messages()) == expected);
}

TEST_CASE("a write that fails takes its chunk with it, and the file stays whole") {
  const Directory directory;
  mcap::Writer writer(directory.file(), options());
  const auto channel = add_channel(writer, "/a");
  const std::string large = payload(1, 2 * kChunk);
  put(writer, {channel, 0, 10, 10}, large);
  const auto before = read_file(directory.file());

  fault = {2, 50, 1, EIO};
  CHECK(error_of([&] { put(writer, {channel, 1, 11, 11}, large); }).first == EIO);
  CHECK(read_file(directory.file()) == before);
  CHECK(writer.lost() == 1);
  fault = {};
  put(writer, {channel, 2, 12, 12}, large);
  CHECK(writer.payload_bytes(channel) == 2 * large.size());
  writer.close();
  const std::vector<std::string> expected{"1 0 10 10 " + large, "1 2 12 12 " + large};
  CHECK(lines(mcap::Reader(directory.file()).messages()) == expected);
  CHECK(mcap::Reader(directory.file()).has_summary());
}

TEST_CASE("a full disk is an error, and what was written before can be read") {
  const SmallDisk disk("size=256k");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  const std::string path = disk.path + "/a.mcap";
  std::vector<std::string> expected;
  mcap::Writer writer(path, options());
  const auto channel = add_channel(writer, "/a");
  std::pair<int, std::string> error;
  for (unsigned i = 0; error.first == 0; ++i) {
    REQUIRE(i < 1000);
    const std::string bytes = payload(i, 5 * kChunk);
    const mcap::MessageHead head{channel, i, i, i};
    error = {};
    try {
      put(writer, head, bytes);
      expected.push_back(line({head, view(bytes)}));
    } catch (const Error& e) {
      error = {e.error_number(), e.what()};
    }
  }
  CHECK(error.first == ENOSPC);
  CHECK(names(error.second, "make room"));
  CHECK(lines(mcap::Stream(path)) == expected);
  CHECK(writer.lost() == 1);
  writer.close();  // the chunk that went leaves room for the summary
  CHECK(mcap::Reader(path).has_summary());
  CHECK(lines(mcap::Reader(path).messages()) == expected);
}

TEST_CASE("a disk that is full in close() leaves a file that is recovered when there is room") {
  const SmallDisk disk("size=64k");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  const std::string path = disk.path + "/a.mcap";
  mcap::Writer writer(path, options());
  const auto expected = fill(writer, 7);
  writer.flush();
  const std::string rest = disk.path + "/rest";
  std::ofstream(rest) << std::string(60 << 10, 'x');      // until nothing fits any more
  const std::size_t left = 4096 - writer.bytes() % 4096;  // in the file's last page
  REQUIRE(left > 17);
  writer.add(mcap::Metadata{std::string(left - 17, 'x'), {}});
  CHECK(error_of([&] { writer.close(); }).first == ENOSPC);
  CHECK(lines(mcap::Stream(path)) == expected);
  CHECK(error_of([&] { mcap::Writer(disk.path + "/b.mcap", options()); }).first == ENOSPC);
  CHECK_FALSE(std::filesystem::exists(disk.path + "/b.mcap"));
  CHECK(error_of([&] { mcap::recover(path); }).first == ENOSPC);
  std::filesystem::remove(rest);
  CHECK(mcap::recover(path).statistics.messages == expected.size());
  CHECK(lines(mcap::Reader(path).messages()) == expected);
  CHECK(mcap::Reader(path).has_summary());
}

TEST_CASE("what a kill leaves at any moment is read up to the last chunk, and recovered") {
  const Watchdog watchdog(100);
  std::mt19937_64 random(seed());
  for (int round = 0; round < 30; ++round) {
    const Directory directory;
    const auto compression = static_cast<Compression>(round % 3);
    Steps steps;
    Child child([&] {
      mcap::Writer writer(directory.file(), options(compression));
      const auto channel = add_channel(writer, "/a");
      steps.tell();
      for (unsigned i = 0;; ++i) {
        put(writer, {channel, i, i, i}, payload(i, i % 7 == 3 ? 3 * kChunk : 200));
      }
    });
    REQUIRE(steps.next() == '.');
    usleep(static_cast<useconds_t>(random() % 20000));
    child.kill9();
    const auto read = lines(mcap::Stream(directory.file()));
    for (unsigned i = 0; i < read.size(); ++i) {
      const std::string n = " " + std::to_string(i);
      REQUIRE(read[i] == "1" + n + n + n + " " + payload(i, i % 7 == 3 ? 3 * kChunk : 200));
    }
    CHECK(lines(mcap::Reader(directory.file()).messages()) == read);
    const auto recovered = mcap::recover(directory.file());
    CHECK_FALSE(recovered.was_whole);
    CHECK(recovered.statistics.messages == read.size());
    CHECK(mcap::recover(directory.file()).was_whole);
    mcap::Reader reader(directory.file());
    CHECK(reader.has_summary());
    CHECK(lines(reader.messages()) == read);
    std::filesystem::remove(directory.file());
  }
}
