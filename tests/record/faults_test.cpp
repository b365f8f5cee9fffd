// SPDX-License-Identifier: Apache-2.0

// lot::Recorder when its file cannot be written: each place where a disk can be full, quotas,
// failing devices. The error is said, what is lost is counted, and the file is right.

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <sys/uio.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/recorder.hpp"
#include "lot/recording.hpp"

#include "mcap/recover.hpp"
#include "record/scene.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/small_disk.hpp"

namespace {

/// What a record of a recording begins with.
enum class Begin : int {
  Magic = 0x89,
  Schema = 3,
  Channel = 4,
  Chunk = 6,
  Metadata = 12,
  DataEnd = 15
};

/// Writes that begin so fail, as long as there are errors to come.
struct Fault {
  std::atomic<int> begin{0};
  std::atomic<int> error{0};
  std::atomic<int> times{0};
  void set(Begin its_begin, int its_error, int its_times = 1'000'000) {
    begin = static_cast<int>(its_begin);
    error = its_error;
    times = its_times;
  }
  void clear() { times = 0; }
};
Fault fault;

/// A disk that takes no chunk while it is held. While it is paced, each chunk waits for an answer.
struct Slow {
  std::atomic<bool> is_held{false};
  std::atomic<bool> is_paced{false};
  std::atomic<std::uint64_t> chunks{0};
  std::atomic<std::uint64_t> answers{0};
};
Slow slow;

}  // namespace

extern "C" ssize_t __real_pwritev(int fd, const iovec* pieces, int count, off_t at);
extern "C" ssize_t __wrap_pwritev(int fd, const iovec* pieces, int count, off_t at) {
  if (*static_cast<const unsigned char*>(pieces[0].iov_base) == fault.begin && fault.times > 0) {
    --fault.times;
    errno = fault.error;
    return -1;
  }
  if (*static_cast<const unsigned char*>(pieces[0].iov_base) == static_cast<int>(Begin::Chunk)) {
    while (slow.is_held) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    const std::uint64_t number = ++slow.chunks;
    while (slow.is_paced && slow.answers < number) std::this_thread::yield();
  }
  return __real_pwritev(fd, pieces, count, at);
}

namespace lot::testing {
namespace {

[[maybe_unused]] const std::string& prefix_taken = prefix();

std::uint64_t lost(const Recorder& recorder, const std::string& topic) {
  const RecorderStatus status = recorder.status();
  const auto* const its = topic_of(status, topic);
  return its == nullptr ? 0 : its->lost;
}
bool is_done(const Recorder& recorder, const std::string& topic, std::uint64_t messages) {
  return eventually([&] {
    const RecorderStatus status = recorder.status();
    const auto* const its = topic_of(status, topic);
    return its != nullptr && its->messages + its->lost == messages && status.held_bytes == 0;
  });
}

TEST_SUITE_BEGIN("record");

TEST_CASE("a chunk that cannot be written: its messages are lost, and the file is right") {
  const Watchdog watchdog(60);
  for (const int error : {ENOSPC, EDQUOT, EIO}) {
    CAPTURE(error);
    Scene scene;
    auto pictures = scene.engine.advertise<Picture>("/pictures");
    Recorder recorder(scene.what(), scene.where);
    put(pictures, 0, 2'000'000);
    REQUIRE(eventually([&] { return recorded(recorder, "/pictures") == 1; }));
    fault.set(Begin::Chunk, error);
    for (std::uint32_t i = 1; i < 4; ++i) put(pictures, i, 2'000'000);
    REQUIRE(eventually([&] { return lost(recorder, "/pictures") == 3; }));
    CHECK(recorder.status().error.find("cannot write") != std::string::npos);
    fault.clear();
    put(pictures, 4, 2'000'000);
    const auto said = error_of([&] { recorder.stop(); });
    CHECK(said.first == error);
    CHECK((error == EIO || names(said.second, "make room")));
    Content content(scene.directory.file());
    CHECK(content.reader.has_summary());
    CHECK_FALSE(content.reader.damage().any());
    REQUIRE(content.messages.size() == 2);
    CHECK(content.messages[0].sequence == 0);
    CHECK(content.messages[1].sequence == 4);
    CHECK(content.said("/pictures", "lost") == "3");
    CHECK(recorder.status().topics[0].messages == 2);
    CHECK(recorder.status().topics[0].bytes ==
          content.messages[0].payload.size() + content.messages[1].payload.size());
  }
}

TEST_CASE("a recording ends at one moment for all topics, also where the disk is slow") {
  const Watchdog watchdog(120);
  Scene scene;
  lot::PusherOptions deep;
  deep.depth = 256;
  auto first = scene.engine.advertise<Picture>("/first", deep);
  auto second = scene.engine.advertise<Picture>("/second", deep);
  RecorderOptions what = scene.what();
  what.chunk_bytes = 1024;  // a chunk for each message
  what.max_held_bytes = 1;  // and one message at a time
  Recorder recorder(what, scene.where);
  std::uint32_t number = 0;
  const auto publish = [&] {
    put(first, number, 5'000);
    put(second, number, 5'000);
    ++number;
  };
  slow.is_held = true;
  while (number < 40) publish();
  std::thread stopping([&] { recorder.stop(); });
  std::this_thread::sleep_for(200ms);  // so that it has been told to stop
  slow.chunks = slow.answers = 0;
  slow.is_paced = true;
  std::thread publishing([&] {  // two messages for each one that is written
    while (slow.is_paced) {
      if (slow.answers == slow.chunks) {
        std::this_thread::yield();
        continue;
      }
      if (number < 200) publish();
      ++slow.answers;
    }
  });
  slow.is_held = false;
  stopping.join();
  slow.is_paced = false;
  publishing.join();
  Content content(scene.directory.file());
  const auto firsts = content.of("/first");
  const auto seconds = content.of("/second");
  REQUIRE(firsts.size() >= 40);
  REQUIRE(seconds.size() >= 40);
  const auto [from, until] = std::minmax(firsts.back().log_time, seconds.back().log_time);
  CHECK(until - from <= firsts.size() + seconds.size());  // nanoseconds: it is one moment
  CHECK(firsts.size() <= seconds.size() + 8);
  CHECK(seconds.size() <= firsts.size() + 8);
}

TEST_CASE("a topic that cannot be noted is lost, and what others have in the open chunk is not") {
  const Watchdog watchdog(60);
  for (const Begin begin : {Begin::Schema, Begin::Channel}) {
    CAPTURE(static_cast<int>(begin));
    Scene scene;
    auto notes = scene.engine.advertise<Note>("/notes");
    auto pictures = scene.engine.advertise<Picture>("/pictures");
    Recorder recorder(scene.what(), scene.where);
    for (std::uint64_t i = 0; i < 10; ++i) put(notes, i);
    REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 10; }));
    fault.set(begin, ENOSPC);
    put(pictures, 0, 10);
    REQUIRE(eventually([&] { return lost(recorder, "/pictures") == 1; }));
    CHECK(lost(recorder, "/notes") == 0);
    fault.clear();
    put(pictures, 1, 10);
    CHECK(error_of([&] { recorder.stop(); }).first == ENOSPC);
    Content content(scene.directory.file());
    CHECK(content.of("/notes").size() == 10);
    CHECK(content.said("/notes", "lost") == "0");
    REQUIRE(content.of("/pictures").size() == 1);
    CHECK(content.of("/pictures")[0].sequence == 1);
    CHECK(content.said("/pictures", "lost") == "1");
    CHECK(recorder.status().topics[0].messages == 10);
  }
}

TEST_CASE("the next file of a split that cannot be made: it is made when there is room") {
  const Watchdog watchdog(60);
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  RecorderOptions what = scene.what();
  what.split_bytes = 1 << 20;
  Recorder recorder(what, scene.where);
  put(pictures, 0, 600'000);
  REQUIRE(eventually([&] { return recorded(recorder, "/pictures") == 1; }));
  fault.set(Begin::Magic, ENOSPC);
  put(pictures, 1, 600'000);
  REQUIRE(eventually([&] { return lost(recorder, "/pictures") == 1; }));
  CHECK_FALSE(std::filesystem::exists(scene.directory.file("a_1.mcap")));
  CHECK(recorder.status().files.size() == 1);
  fault.clear();
  std::uint32_t next = 2;
  for (; recorder.status().files.size() < 2; ++next) {
    put(pictures, next, 600'000);
    REQUIRE(is_done(recorder, "/pictures", next + 1));
  }
  CHECK(error_of([&] { recorder.stop(); }).first == ENOSPC);
  const RecorderStatus status = recorder.status();
  REQUIRE(status.files.size() == 2);
  CHECK(status.files[1] == scene.directory.file("a_1.mcap"));
  Content first(status.files[0]);
  Content second(status.files[1]);
  CHECK(first.reader.has_summary());
  CHECK(first.messages.size() == 1);
  REQUIRE(second.messages.size() == 1);
  CHECK(second.messages[0].sequence == next - 1);
  CHECK(second.said("/pictures", "lost") == std::to_string(next - 2));
}

TEST_CASE("the last seconds stay where their file cannot be made, until the next trigger") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  RecorderOptions what = scene.what();
  what.keep_last = 1h;
  Recorder recorder(what, scene.where);
  for (std::uint64_t i = 0; i < 10; ++i) put(notes, i);
  fault.set(Begin::Magic, EDQUOT);
  REQUIRE(eventually([&] {
    recorder.trigger();
    return !recorder.status().error.empty();
  }));
  CHECK(recorder.status().files.empty());
  fault.clear();
  REQUIRE(eventually([&] {
    recorder.trigger();
    return !recorder.status().files.empty();
  }));
  CHECK(error_of([&] { recorder.stop(); }).first == EDQUOT);
  const Content content(recorder.status().files[0]);
  REQUIRE_FALSE(content.messages.empty());
  for (std::size_t i = 0; i < content.messages.size(); ++i) {
    CHECK(number_in(content.messages[i].payload) == i);
  }
}

TEST_CASE("an end that cannot be written: all messages are there, and recover() writes it") {
  const Watchdog watchdog(60);
  for (const Begin begin : {Begin::Metadata, Begin::DataEnd}) {
    CAPTURE(static_cast<int>(begin));
    Scene scene;
    auto notes = scene.engine.advertise<Note>("/notes");
    Recorder recorder(scene.what(), scene.where);
    for (std::uint64_t i = 0; i < 10; ++i) put(notes, i);
    REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 10; }));
    fault.set(begin, ENOSPC);
    CHECK(error_of([&] { recorder.stop(); }).first == ENOSPC);
    fault.clear();
    CHECK(recorder.status().topics[0].messages == 10);
    CHECK(recorder.status().topics[0].lost == 0);
    {
      const Recording recording(scene.directory.file());
      REQUIRE(recording.topics().size() == 1);
      CHECK(recording.topics()[0].messages == 10);
      CHECK(recording.topics()[0].missed == 0);
      CHECK(recording.damage().is_cut == (begin == Begin::DataEnd));
    }
    CHECK(mcap::recover(scene.directory.file()).was_whole == (begin == Begin::Metadata));
    CHECK(Content(scene.directory.file()).messages.size() == 10);
  }
}

TEST_CASE("a disk that is full to the end: the file is right up to its last chunk") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=3M");
  if (disk.path.empty()) {
    std::printf("skipped: can not mount a tmpfs\n");
    return;
  }
  for (const Compression compression : {Compression::None, Compression::Lz4, Compression::Zstd}) {
    Scene scene;
    auto pictures = scene.engine.advertise<Picture>("/pictures");
    RecorderOptions what = scene.what();
    what.path = disk.path + "/a.mcap";
    what.compression = compression;
    what.chunk_bytes = 1 << 16;
    std::ofstream(disk.path + "/filler") << std::string(2'900'000, 'x');
    Recorder recorder(what, scene.where);
    std::uint32_t n = 0;
    for (; lost(recorder, "/pictures") == 0; ++n) {
      put(pictures, n, 70'000);
      REQUIRE(is_done(recorder, "/pictures", n + 1));
    }
    std::ofstream(disk.path + "/filler", std::ios::app) << std::string(3'000'000, 'x');
    CHECK(error_of([&] { recorder.stop(); }).first == ENOSPC);
    const std::uint64_t there = recorder.status().topics[0].messages;
    CHECK(there + recorder.status().topics[0].lost == n);
    const Content content(what.path);
    CHECK_FALSE(content.reader.damage().any());
    REQUIRE(content.messages.size() == there);
    for (std::uint32_t i = 0; i < there; ++i) CHECK(content.messages[i].sequence == i);
    std::filesystem::remove(disk.path + "/filler");
    std::filesystem::remove(what.path);
  }
}

}  // namespace
}  // namespace lot::testing
