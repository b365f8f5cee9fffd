// SPDX-License-Identifier: Apache-2.0

// lot::Recorder: which topics and messages are in its files, what is counted, what faults leave.

#include "lot/recorder.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "codec/encode.hpp"
#include "record/observer.hpp"
#include "record/scene.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/small_disk.hpp"

namespace lot::testing {
namespace {

struct Chained {
  ShmRef<const Note> note;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// A message as CDR.
template <class T>
std::string cdr(const T& message) {
  const codec::Program program(describe<T>());
  codec::Encoded bytes;
  const auto* const begin = reinterpret_cast<const unsigned char*>(&message);
  encode(program, Value(describe<T>(), &message, begin, begin + sizeof(T)), bytes);
  std::string all;
  for (const Bytes& piece : bytes.pieces()) {
    all.append(reinterpret_cast<const char*>(piece.data()), piece.size());
  }
  return all;
}

TEST_SUITE_BEGIN("record");

TEST_CASE("a file is as open as its segment, but for what the umask takes away") {
  const Watchdog watchdog(60);
  const mode_t before = umask(022);
  const struct {
    mode_t segment;
    mode_t file;
  } modes[] = {{0600, 0600}, {0660, 0640}, {0666, 0644}};
  for (const auto& [its_mode, expected] : modes) {
    CAPTURE(its_mode);
    EngineOptions where = fresh();
    where.permissions = its_mode;
    const Directory directory;
    ShmEngine engine(where);
    auto notes = engine.advertise<Note>("/notes");
    RecorderOptions what;
    what.path = directory.file();
    what.topics = {"*"};
    Recorder recorder(what, where);
    const auto mode = [&] { return std::filesystem::status(what.path).permissions(); };
    CHECK(mode() == std::filesystem::perms(0600));
    put(notes, 1);
    REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 1; }));
    CHECK(mode() == std::filesystem::perms(expected));
    recorder.stop();
  }
  umask(before);
}

TEST_CASE("all messages between construction and stop are in the file, in their order") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  Recorder recorder(scene.what(), scene.where);
  for (std::uint32_t i = 0; i < 40; ++i) {
    put(notes, i);
    put(pictures, i, i % 2 == 0 ? 100 : 100'000);
  }
  recorder.stop();
  Content content(scene.directory.file());
  CHECK(content.reader.has_summary());
  CHECK_FALSE(content.reader.damage().any());
  const auto of_notes = content.of("/notes");
  const auto of_pictures = content.of("/pictures");
  REQUIRE(of_notes.size() == 40);
  REQUIRE(of_pictures.size() == 40);
  for (std::uint32_t i = 0; i < 40; ++i) {
    CHECK(of_notes[i].sequence == i);
    CHECK(of_notes[i].payload == cdr(Note{i}));
    CHECK(of_pictures[i].sequence == i);
    CHECK(of_pictures[i].payload.size() > (i % 2 == 0 ? 100U : 100'000U));
    CHECK(of_pictures[i].payload.find("picture " + std::to_string(i)) != std::string::npos);
  }
  CHECK(content.said("/notes", "missed") == "0");
}

TEST_CASE("a channel says type and schema, and the type is found again by it") {
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  Recorder recorder(scene.what(), scene.where);
  put(pictures, 1, 10);
  recorder.stop();
  const Content content(scene.directory.file());
  REQUIRE(content.reader.channels().size() == 1);
  const mcap::Channel& channel = content.reader.channels().begin()->second;
  CHECK(channel.message_encoding == "cdr");
  const mcap::Schema& schema = content.reader.schemas().at(channel.schema);
  CHECK(schema.encoding == "ros2msg");
  CHECK(text(schema.data).find("uint8[] pixels") != std::string::npos);
  CHECK(channel.metadata.at("lot.topic") == "/pictures");
  CHECK(channel.metadata.contains("lot.description"));
}

TEST_CASE("topics are chosen by names and patterns, and left out by others") {
  Scene scene;
  std::vector<ShmPusher<Note>> pushers;
  for (const char* topic : {"/a/one", "/a/two", "/b/one", "/b/deep/er"}) {
    pushers.push_back(scene.engine.advertise<Note>(topic));
  }
  RecorderOptions what = scene.what();
  what.topics = {"/a/*", "/b/*"};
  what.except = {"*/two"};
  Recorder recorder(what, scene.where);
  for (auto& pusher : pushers) put(pusher, 1);
  recorder.stop();
  const Content content(scene.directory.file());
  CHECK(content.of("/a/one").size() == 1);
  CHECK(content.of("/a/two").empty());
  CHECK(content.of("/b/one").size() == 1);
  CHECK(content.of("/b/deep/er").size() == 1);
}

TEST_CASE("names and patterns that no topic has fitted are told until one does") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  RecorderOptions what = scene.what();
  what.topics = {"/notes", "/late", "/pic*"};
  what.except = {"/notes/*"};
  Recorder recorder(what, scene.where);
  CHECK(recorder.status().unmatched == std::vector<std::string>{"/late", "/pic*", "/notes/*"});
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  auto left_out = scene.engine.advertise<Note>("/notes/inner");
  CHECK(
      eventually([&] { return recorder.status().unmatched == std::vector<std::string>{"/late"}; }));
}

TEST_CASE("a topic that comes later is recorded from its first message on") {
  const Watchdog watchdog(60);
  Scene scene;
  Recorder recorder(scene.what(), scene.where);
  auto notes = scene.engine.advertise<Note>("/late");
  for (std::uint64_t i = 0; i < 10; ++i) put(notes, i);
  CHECK(eventually([&] { return recorded(recorder, "/late") == 10; }));
  put(notes, 10);
  recorder.stop();
  const auto all = Content(scene.directory.file()).of("/late");
  REQUIRE(all.size() == 11);
  for (std::uint64_t i = 0; i < all.size(); ++i) CHECK(number_in(all[i].payload) == i);
}

TEST_CASE("what a late topic's queue had lost before the recorder saw it is counted") {
  const Watchdog watchdog(60);
  Scene scene;
  Recorder recorder(scene.what(), scene.where);
  PusherOptions few;
  few.depth = 4;
  auto notes = scene.engine.advertise<Note>("/late", few);
  for (std::uint64_t i = 0; i < 20; ++i) put(notes, i);
  recorder.stop();
  Content content(scene.directory.file());
  REQUIRE_FALSE(content.messages.empty());
  for (const auto& one : content.messages) CHECK(one.sequence == number_in(one.payload));
  CHECK(content.said("/late", "missed") == std::to_string(20 - content.messages.size()));
}

TEST_CASE("a topic that comes just before stop is in the file") {
  Scene scene;
  Recorder recorder(scene.what(), scene.where);
  auto notes = scene.engine.advertise<Note>("/late");
  put(notes, 7);
  recorder.stop();
  CHECK(Content(scene.directory.file()).of("/late").size() == 1);
}

TEST_CASE("what was there before the begin: the last message of each publisher") {
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/latched");
  for (std::uint64_t i = 0; i < 5; ++i) put(notes, i);
  Recorder recorder(scene.what(), scene.where);
  recorder.stop();
  const auto all = Content(scene.directory.file()).of("/latched");
  REQUIRE(all.size() == 1);
  CHECK(number_in(all[0].payload) == 4);
}

TEST_CASE("a topic that gets another type has two channels") {
  const Watchdog watchdog(60);
  Scene scene;
  Recorder recorder(scene.what(), scene.where);
  {
    auto notes = scene.engine.advertise<Note>("/changes");
    put(notes, 1);
    CHECK(eventually([&] { return recorded(recorder, "/changes") == 1; }));
  }
  auto pictures = scene.engine.advertise<Picture>("/changes");
  put(pictures, 2, 10);
  CHECK(eventually([&] {
    std::uint64_t sum = 0;
    for (const auto& topic : recorder.status().topics) sum += topic.messages;
    return sum == 2;
  }));
  recorder.stop();
  const Content content(scene.directory.file());
  CHECK(content.reader.channels().size() == 2);
  CHECK(content.reader.schemas().size() == 2);
  CHECK(content.of("/changes").size() == 2);
}

TEST_CASE("a name of lot::ros is recorded as ROS calls it") {
  CHECK(record::name_in_file("3f09c1d2 /camera/image") == "/camera/image");
  CHECK(record::name_in_file("3f09c1d2 camera") == "3f09c1d2 camera");
  CHECK(record::name_in_file("3F09c1d2 /camera") == "3F09c1d2 /camera");
  CHECK(record::name_in_file("/camera") == "/camera");
}

TEST_CASE("queues and types that no file can have are refused, and named in the file") {
  Scene scene;
  auto queue = scene.engine.queue<Note>("/jobs");
  must_go(queue.put(Note{1}));
  auto chained = scene.engine.advertise<Chained>("/chained");
  Recorder recorder(scene.what(), scene.where);
  const RecorderStatus status = recorder.status();
  CHECK(status.topics.empty());
  CHECK(status.refused.size() == 2);
  recorder.stop();
  Content content(scene.directory.file());
  std::size_t refused = 0;
  for (const auto& index : content.reader.metadata()) {
    refused += content.reader.read(index).name == "lot.refused";
  }
  CHECK(refused == 2);
  CHECK(queue.size() == 1);
}

TEST_CASE("what is overwritten before the recorder looks is a gap in the numbers, and counted") {
  const Watchdog watchdog(60);
  Scene scene;
  PusherOptions few;
  few.depth = 4;
  auto notes = scene.engine.advertise<Note>("/notes", few);
  Recorder recorder(scene.what(), scene.where);
  put(notes, 0);
  REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 1; }));
  constexpr std::uint64_t kMany = 100'000;
  for (std::uint64_t i = 1; i < kMany; ++i) put(notes, i);  // faster than any observer
  recorder.stop();
  Content content(scene.directory.file());
  const auto all = content.of("/notes");
  REQUIRE(all.size() >= 2);
  for (const auto& one : all) CHECK(one.sequence == number_in(one.payload));
  CHECK(all.back().sequence == kMany - 1);
  CHECK(content.said("/notes", "missed") == std::to_string(kMany - all.size()));
}

TEST_CASE("lossless publishers do not wait for a recorder") {
  const Watchdog watchdog(60);
  Scene scene;
  PusherOptions lossless;
  lossless.policy = Policy::Refuse;
  lossless.depth = 4;
  auto notes = scene.engine.advertise<Note>("/notes", lossless);
  Recorder recorder(scene.what(), scene.where);
  for (std::uint64_t i = 0; i < 10'000; ++i) put(notes, i);
  recorder.stop();
}

TEST_CASE("log times are those of the system at the begin, and grow; publish times are the push") {
  using namespace std::chrono;
  Scene scene;
  PusherOptions stamped;
  stamped.stamp = true;
  auto notes = scene.engine.advertise<Note>("/stamped", stamped);
  auto others = scene.engine.advertise<Note>("/not", PusherOptions());
  const auto before = system_clock::now().time_since_epoch();
  Recorder recorder(scene.what(), scene.where);
  put(notes, 1);
  put(others, 1);
  recorder.stop();
  const auto after = system_clock::now().time_since_epoch() + 1s;
  const Content content(scene.directory.file());
  REQUIRE(content.messages.size() == 2);
  for (const auto& one : content.messages) {
    CHECK(one.log_time >= static_cast<std::uint64_t>(nanoseconds(before).count()));
    CHECK(one.log_time <= static_cast<std::uint64_t>(nanoseconds(after).count()));
    if (one.topic == "/not") CHECK(one.publish_time == one.log_time);
    if (one.topic == "/stamped") CHECK(one.publish_time <= one.log_time);
  }
}

TEST_CASE("compressed and without checksums it is the same") {
  for (const Compression compression : {Compression::None, Compression::Lz4, Compression::Zstd}) {
    for (const bool crcs : {true, false}) {
      Scene scene;
      auto pictures = scene.engine.advertise<Picture>("/pictures");
      RecorderOptions what = scene.what();
      what.compression = compression;
      what.crcs = crcs;
      Recorder recorder(what, scene.where);
      for (std::uint32_t i = 0; i < 8; ++i) put(pictures, i, 300'000);
      recorder.stop();
      const Content content(scene.directory.file());
      REQUIRE(content.messages.size() == 8);
      const bool is_small = std::filesystem::file_size(scene.directory.file()) < 8 * 300'000;
      CHECK(is_small == (compression != Compression::None));
    }
  }
}

TEST_CASE("a recording is split by size, and no message is lost or twice") {
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  RecorderOptions what = scene.what();
  what.split_bytes = 1 << 20;
  Recorder recorder(what, scene.where);
  for (std::uint32_t i = 0; i < 20; ++i) put(pictures, i, 200'000);
  recorder.stop();
  const RecorderStatus status = recorder.status();
  REQUIRE(status.files.size() >= 4);
  std::uint32_t next = 0;
  std::size_t number = 0;
  for (const std::string& file : status.files) {
    Content content(file);
    CHECK(content.reader.has_summary());
    const auto begin = content.reader.metadata();
    REQUIRE_FALSE(begin.empty());
    CHECK(content.reader.read(begin.front()).pairs.at("file") == std::to_string(number++));
    CHECK(std::filesystem::file_size(file) < (1 << 20) + 4096);
    for (const auto& one : content.messages) CHECK(one.sequence == next++);
  }
  CHECK(next == 20);
  CHECK(status.files[1] == scene.directory.file("a_1.mcap"));
}

TEST_CASE("a recording is split by time") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  RecorderOptions what = scene.what();
  what.split_time = 20ms;
  Recorder recorder(what, scene.where);
  for (std::uint64_t i = 0; recorder.status().files.size() < 3; ++i) {
    put(notes, i);
    std::this_thread::sleep_for(1ms);
  }
  recorder.stop();
  for (const std::string& file : recorder.status().files) {
    const Content content(file);
    REQUIRE_FALSE(content.messages.empty());
    CHECK(content.messages.back().log_time - content.messages.front().log_time < 20'000'000);
  }
}

TEST_CASE("a rate leaves messages out, and that is no gap") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  RecorderOptions what = scene.what();
  what.max_rate = 0.001;  // the first one alone
  Recorder recorder(what, scene.where);
  for (std::uint64_t i = 0; i < 50; ++i) put(notes, i);
  recorder.stop();
  Content content(scene.directory.file());
  CHECK(content.messages.size() == 1);
  CHECK(content.said("/notes", "left_out") == "49");
  CHECK(content.said("/notes", "missed") == "0");
}

TEST_CASE("what waits to be written keeps within the quota") {
  const Watchdog watchdog(60);
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  RecorderOptions what = scene.what();
  what.max_held_bytes = 400'000;
  Recorder recorder(what, scene.where);
  std::uint64_t most = 0;
  for (std::uint32_t i = 0; i < 200; ++i) {
    put(pictures, i, 100'000);
    most = std::max(most, recorder.status().held_bytes);
  }
  recorder.stop();
  CHECK(most <= 400'000 + 120'000);
  CHECK(recorder.status().held_bytes == 0);
  const RecorderStatus status = recorder.status();
  CHECK(status.topics[0].messages + status.topics[0].missed == 200);
}

TEST_CASE("only the last seconds: nothing is written before a trigger, and then what was before") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  RecorderOptions what = scene.what();
  what.keep_last = 1h;
  Recorder recorder(what, scene.where);
  for (std::uint64_t i = 0; i < 10; ++i) put(notes, i);
  REQUIRE(eventually([&] { return recorder.status().kept_messages == 10; }));
  CHECK(recorder.status().files.empty());
  recorder.trigger();
  REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 10; }));
  CHECK(recorder.status().kept_messages == 0);
  put(notes, 10);
  recorder.stop();
  REQUIRE(recorder.status().files.size() == 1);
  const Content content(scene.directory.file("a_0.mcap"));
  const auto all = content.of("/notes");
  REQUIRE(all.size() == 10);
  CHECK(number_in(all.back().payload) == 9);
}

TEST_CASE("only the last seconds: at most so many bytes are kept") {
  const Watchdog watchdog(60);
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  RecorderOptions what = scene.what();
  what.keep_last = 1h;
  what.keep_last_bytes = 1'000'000;
  Recorder recorder(what, scene.where);
  for (std::uint32_t i = 0; i < 49; ++i) put(pictures, i, 100'000);
  put(pictures, 49, 300'000);  // it takes the place of three
  REQUIRE(eventually([&] {
    const RecorderStatus status = recorder.status();
    return status.kept_messages == 7 && status.kept_bytes > 900'000;
  }));
  recorder.trigger();
  recorder.stop();
  REQUIRE(recorder.status().files.size() == 1);
  const Content content(recorder.status().files[0]);
  CHECK(content.messages.size() == 7);
  CHECK(content.messages.back().sequence == 49);
}

TEST_CASE("a message on the trigger's topic is a trigger, and what comes behind it follows") {
  const Watchdog watchdog(60);
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  auto faults = scene.engine.advertise<Note>("/fault");
  RecorderOptions what = scene.what();
  what.topics = {"/notes"};
  what.keep_last = 1h;
  what.keep_after = 1h;
  what.trigger = "/fault";
  Recorder recorder(what, scene.where);
  put(notes, 1);
  REQUIRE(eventually([&] { return recorder.status().kept_messages == 1; }));
  put(faults, 1);
  REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 1; }));
  put(notes, 2);
  REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 2; }));
  recorder.stop();
  const Content content(scene.directory.file("a_0.mcap"));
  CHECK(content.of("/notes").size() == 2);
  CHECK(content.of("/fault").empty());
}

// ---- faults
// ---------------------------------------------------------------------------------------

TEST_CASE("two recorders on one file: the second one is refused, and the file stays the first's") {
  Scene scene;
  auto notes = scene.engine.advertise<Note>("/notes");
  Recorder recorder(scene.what(), scene.where);
  CHECK(error_of([&] { Recorder(scene.what(), scene.where); }).first == EEXIST);
  put(notes, 1);
  recorder.stop();
  CHECK(Content(scene.directory.file()).messages.size() == 1);
}

TEST_CASE("a directory that is not there, and options that cannot be, are refused") {
  Scene scene;
  RecorderOptions what = scene.what();
  what.path = scene.directory.file("none/a.mcap");
  CHECK(error_of([&] { Recorder(what, scene.where); }).first == ENOENT);
  for (const auto& spoil : std::vector<void (*)(RecorderOptions&)>{
           [](RecorderOptions& o) { o.path.clear(); }, [](RecorderOptions& o) { o.topics.clear(); },
           [](RecorderOptions& o) { o.chunk_bytes = 1; },
           [](RecorderOptions& o) { o.max_rate = -1; },
           [](RecorderOptions& o) { o.trigger = "/fault"; },
           [](RecorderOptions& o) { o.keep_after = 1s; },
           [](RecorderOptions& o) {
             o.split_bytes = 1;
             o.keep_last = 1s;
           }}) {
    RecorderOptions bad = scene.what();
    spoil(bad);
    CHECK(error_of([&] { Recorder(bad, scene.where); }).first == EINVAL);
  }
}

TEST_CASE("a directory that vanishes: what cannot be written is counted, and it goes on") {
  const Watchdog watchdog(60);
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  RecorderOptions what = scene.what();
  std::filesystem::create_directory(scene.directory.file("room"));
  what.path = scene.directory.file("room/a.mcap");
  Recorder recorder(what, scene.where);
  put(pictures, 0, 2'000'000);
  REQUIRE(eventually([&] { return recorded(recorder, "/pictures") == 1; }));
  std::filesystem::remove_all(scene.directory.file("room"));
  put(pictures, 1, 2'000'000);
  // The one that was written is gone with its file.
  REQUIRE(eventually([&] { return recorder.status().topics[0].lost == 2; }));
  CHECK(recorder.status().topics[0].messages == 0);
  CHECK(recorder.status().topics[0].bytes == 0);
  CHECK(eventually([&] { return recorder.status().error.find("removed") != std::string::npos; }));
  std::filesystem::create_directory(scene.directory.file("room"));
  for (std::uint32_t i = 2; recorded(recorder, "/pictures") == 0; ++i) {
    put(pictures, i, 2'000'000);
    std::this_thread::sleep_for(20ms);
  }
  CHECK(error_of([&] { recorder.stop(); }).first == ENOENT);
  CHECK(recorder.status().files.size() == 1);
  const Content content(what.path);
  CHECK(content.messages.size() == recorder.status().topics[0].messages);
  REQUIRE_FALSE(content.messages.empty());
  CHECK(content.messages.front().sequence >= 2);
}

TEST_CASE("a disk that is full: what is lost is counted, and with room it goes on") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=3M");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  Scene scene;
  auto pictures = scene.engine.advertise<Picture>("/pictures");
  RecorderOptions what = scene.what();
  what.path = disk.path + "/a.mcap";
  const std::string filler = disk.path + "/filler";
  write_file(filler, std::string(2'000'000, 'x'));
  Recorder recorder(what, scene.where);
  for (std::uint32_t i = 0; i < 4; ++i) put(pictures, i, 400'000);
  REQUIRE(eventually([&] {
    const RecorderStatus status = recorder.status();
    return !status.topics.empty() && status.topics[0].lost != 0 &&
           status.topics[0].lost + status.topics[0].messages == 4;
  }));
  std::filesystem::remove(filler);
  put(pictures, 4, 400'000);
  REQUIRE(eventually([&] {
    const RecorderStatus status = recorder.status();
    return status.topics[0].lost + status.topics[0].messages == 5;
  }));
  CHECK(error_of([&] { recorder.stop(); }).first == ENOSPC);
  Content content(what.path);
  CHECK(content.reader.has_summary());
  CHECK(content.messages.back().sequence == 4);
  CHECK(content.said("/pictures", "lost") == std::to_string(5 - content.messages.size()));
  std::filesystem::remove(what.path);
}

TEST_CASE("a recorder that is killed leaves what it wrote, and its publishers go on") {
  const Watchdog watchdog(60);
  const Directory directory;
  const EngineOptions where = fresh();
  RecorderOptions what;
  what.path = directory.file();
  what.topics = {"*"};
  Steps steps;
  Child child([&] {  // before threads start: ThreadSanitizer lets no child of threads start its own
    Recorder recorder(what, where);
    steps.tell();
    for (bool told = false;; std::this_thread::sleep_for(1ms)) {
      if (!told && recorded(recorder, "/pictures") == 3) steps.tell();
      told = told || recorded(recorder, "/pictures") == 3;
    }
  });
  ShmEngine engine(where);
  auto pictures = engine.advertise<Picture>("/pictures");
  REQUIRE(steps.next() != '\0');
  for (std::uint32_t i = 0; i < 3; ++i) put(pictures, i, 2'000'000);
  REQUIRE(steps.next() != '\0');
  child.kill9();
  for (std::uint32_t i = 0; i < 20; ++i) put(pictures, i, 2'000'000);
  const Content content(what.path);
  CHECK_FALSE(content.reader.has_summary());
  CHECK(content.messages.size() == 3);
}

TEST_CASE("a recorder goes on in a segment that was made anew") {
  const Watchdog watchdog(60);
  const Directory directory;
  const EngineOptions where = fresh();
  RecorderOptions what;
  what.path = directory.file();
  what.topics = {"*"};
  auto before = std::make_unique<ShmEngine>(where);
  Recorder recorder(what, where);
  {
    auto notes = before->advertise<Note>("/notes");
    put(notes, 1);
    REQUIRE(eventually([&] { return recorded(recorder, "/notes") == 1; }));
  }
  remove_files_of(where);
  before.reset();
  ShmEngine after(where);
  auto notes = after.advertise<Note>("/notes");
  put(notes, 2);
  CHECK(eventually([&] { return recorded(recorder, "/notes") == 2; }));
  recorder.stop();
  CHECK(Content(directory.file()).messages.size() == 2);
}

}  // namespace
}  // namespace lot::testing
