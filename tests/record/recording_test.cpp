// SPDX-License-Identifier: Apache-2.0

// lot::Recording: reads, seeks, filters, decodes; files of others, damaged ones, and forged ones.

#include "lot/recording.hpp"

#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"
#include "lot/recorder.hpp"

#include "codec/decode.hpp"
#include "codec/encode.hpp"
#include "codec/random_types.hpp"
#include "codec/schema.hpp"
#include "mcap/writer.hpp"
#include "record/schema_text.hpp"
#include "record/types.hpp"
#include "support/error_of.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/scratch.hpp"
#include "support/seed.hpp"

namespace lot::testing {
namespace {

struct Note {
  std::uint64_t number = 0;
};
struct Picture {
  std::uint32_t number;
  bool is_bright;
  ShmString label;
  ShmVector<std::uint8_t> pixels;
  ShmVector<ShmVector<float>> rows;
};
/// The same fields, and another type.
struct OtherNote {
  std::uint64_t number = 0;
};
struct Chained {
  ShmRef<const Note> note;
};
struct Unlike {
  std::uint64_t count = 0;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

void put(ShmPusher<Note>& pusher, std::uint64_t number) {
  must_go(pusher.push(pusher.loan(Note{number})));
}
void put(ShmPusher<Picture>& pusher, std::uint32_t number) {
  auto picture = pusher.loan();
  picture->number = number;
  picture->is_bright = number % 2 == 0;
  picture->label = "picture number " + std::to_string(number);
  picture->pixels.resize(1000 * number);
  picture->rows.resize(number % 4);
  for (auto& row : picture->rows) row.resize(3);
  must_go(pusher.push(std::move(picture)));
}

/// Ten notes and ten pictures, recorded in turn.
std::string record(const Directory& directory, const std::string& name = "a.mcap",
                   std::uint64_t split = 0) {
  const EngineOptions where = fresh();
  ShmEngine engine(where);
  auto notes = engine.advertise<Note>("/notes");
  auto pictures = engine.advertise<Picture>("/pictures");
  RecorderOptions what;
  what.path = directory.file(name);
  what.topics = {"*"};
  what.split_bytes = split;
  Recorder recorder(what, where);
  for (std::uint32_t i = 0; i < 10; ++i) {
    put(notes, i);
    put(pictures, i);
  }
  recorder.stop();
  return recorder.status().files.front();
}

std::vector<std::string> payloads(Recording& recording, const std::string& topic) {
  RecordingQuery query;
  query.topics = {topic};
  std::vector<std::string> all;
  auto messages = recording.messages(query);
  while (const auto message = messages.next()) all.push_back(text(message->payload()));
  return all;
}

/// A file of another program: messages with 8 bytes, at 1, 2, 3 ... seconds.
std::string file_of_others(const Directory& directory, const std::string& schema_text,
                           const std::string& message_encoding = "cdr",
                           const std::string& schema_encoding = "ros2msg",
                           const mcap::Pairs& pairs = {}) {
  const std::string path = directory.file("others.mcap");
  mcap::WriterOptions how;
  how.header.library = "another program";
  mcap::Writer writer(path, how);
  mcap::Schema schema;
  schema.name = "pkg/msg/Count";
  schema.encoding = schema_encoding;
  const auto bytes = std::as_bytes(std::span(schema_text));
  schema.data.assign(bytes.begin(), bytes.end());
  mcap::Channel channel;
  channel.schema = writer.add(schema);
  channel.topic = "/count";
  channel.message_encoding = message_encoding;
  channel.metadata = pairs;
  const std::uint16_t id = writer.add(channel);
  for (std::uint64_t i = 1; i <= 3; ++i) {
    std::string payload("\0\1\0\0", 4);
    payload.append(reinterpret_cast<const char*>(&i), sizeof(i));
    const mcap::View piece = std::as_bytes(std::span(payload));
    writer.write({id, 0, i * 1'000'000'000, i * 1'000'000'000}, std::span(&piece, 1));
  }
  writer.close();
  return path;
}
std::string objection_to(const std::string& path) {
  return Recording(path).topics().at(0).objection;
}

TEST_SUITE_BEGIN("record");

TEST_CASE("what was recorded is read: topics, numbers, values") {
  const Directory directory;
  Recording recording(record(directory));
  REQUIRE(recording.topics().size() == 2);
  for (const RecordedTopic& topic : recording.topics()) {
    CHECK(topic.messages == 10);
    CHECK(topic.missed == 0);
    CHECK(topic.objection.empty());
    CHECK(topic.encoding == "cdr");
  }
  auto messages = recording.messages();
  std::uint32_t notes = 0;
  std::uint32_t pictures = 0;
  RecordedTime last = RecordedTime::min();
  while (const auto message = messages.next()) {
    CHECK(message->log_time() >= last);
    last = message->log_time();
    if (message->topic().name == "/notes") {
      CHECK(message->sequence() == notes);
      CHECK(message->root()["number"].as<std::uint64_t>() == notes++);
    } else {
      const Value picture = message->root();
      CHECK(picture["label"].as<std::string>() == "picture number " + std::to_string(pictures));
      CHECK(picture["is_bright"].as<bool>() == (pictures % 2 == 0));
      CHECK(picture["pixels"].size() == 1000 * pictures);
      CHECK(picture["rows"].size() == pictures++ % 4);
    }
  }
  CHECK(notes == 10);
  CHECK(pictures == 10);
  CHECK(last == recording.end());
  CHECK(recording.damage().first.empty());
  CHECK_FALSE(recording.damage().is_cut);
}

TEST_CASE("messages are sought by time and by topic") {
  const Directory directory;
  Recording recording(file_of_others(directory, "uint64 n\n"));
  const auto count = [&](std::chrono::nanoseconds from, std::chrono::nanoseconds until) {
    RecordingQuery query;
    query.from = RecordedTime(from);
    query.until = RecordedTime(until);
    auto messages = recording.messages(query);
    std::size_t n = 0;
    while (messages.next()) ++n;
    return n;
  };
  CHECK(count(0s, 10s) == 3);
  CHECK(count(2s, 10s) == 2);
  CHECK(count(2s, 2s) == 1);
  CHECK(count(4s, 10s) == 0);
  CHECK(count(-1s, -1ns) == 0);
  RecordingQuery query;
  query.topics = {"/none"};
  CHECK_FALSE(recording.messages(query).next());
  query.topics = {"/c*"};
  CHECK(recording.messages(query).next());
  CHECK(recording.begin() == RecordedTime(1s));
  CHECK(recording.end() == RecordedTime(3s));
}

TEST_CASE("the files of a split recording are read as one, in whatever order they are named") {
  const Directory directory;
  const EngineOptions where = fresh();
  ShmEngine engine(where);
  auto pictures = engine.advertise<Picture>("/pictures");
  RecorderOptions what;
  what.path = directory.file();
  what.topics = {"*"};
  what.split_bytes = 20'000;
  Recorder recorder(what, where);
  for (std::uint32_t i = 0; i < 12; ++i) put(pictures, i);
  recorder.stop();
  auto files = recorder.status().files;
  REQUIRE(files.size() > 2);
  std::reverse(files.begin(), files.end());
  Recording recording(files);
  REQUIRE(recording.topics().size() == 1);
  CHECK(recording.topics()[0].messages == 12);
  auto messages = recording.messages();
  std::uint32_t next = 0;
  while (const auto message = messages.next()) CHECK(message->sequence() == next++);
  CHECK(next == 12);
}

TEST_CASE("a message becomes a loan, which typed programs get, and it is equal to it") {
  const Watchdog watchdog(60);
  const Directory directory;
  Recording recording(record(directory));
  ShmEngine engine(fresh());
  auto puller = engine.subscribe<Picture>("/again");
  const RecordedTopic& topic =
      recording.topics()[recording.topics()[0].name == "/pictures" ? 0 : 1];
  AnyPusher pusher = engine.advertise_any("/again", recording.type_of(topic));
  RecordingQuery query;
  query.topics = {"/pictures"};
  auto messages = recording.messages(query);
  std::uint32_t n = 0;
  while (const auto message = messages.next()) {
    AnyLoan loan = pusher.loan();
    message->copy_to(loan);
    must_go(pusher.push(std::move(loan)));
    const auto picture = puller.try_pull();
    REQUIRE(picture);
    CHECK(picture->number == n);
    CHECK(picture->pixels.size() == 1000 * n++);
    CHECK(message->is_equal(picture));
  }
  CHECK(n == 10);
  auto other = engine.advertise<Picture>("/other");
  put(other, 3);
  auto reader = engine.subscribe<Picture>("/other", [] {
    PullerOptions latched;
    latched.history = 1;
    return latched;
  }());
  auto first = recording.messages(query);
  CHECK_FALSE(first.next()->is_equal(reader.try_pull()));
  CHECK_FALSE(first.next()->is_equal(AnyMessage()));
}

TEST_CASE("what is recorded again has the same payloads, bit for bit") {
  const Watchdog watchdog(60);
  const Directory directory;
  Recording recording(record(directory));
  const EngineOptions where = fresh();
  ShmEngine engine(where);
  RecorderOptions what;
  what.path = directory.file("again.mcap");
  what.topics = {"*"};
  Recorder recorder(what, where);
  for (const RecordedTopic& topic : recording.topics()) {
    AnyPusher pusher = engine.advertise_any(topic.name, recording.type_of(topic));
    RecordingQuery query;
    query.topics = {topic.name};
    auto messages = recording.messages(query);
    while (const auto message = messages.next()) {
      AnyLoan loan = pusher.loan();
      message->copy_to(loan);
      must_go(pusher.push(std::move(loan)));
    }
    REQUIRE(eventually([&] {
      std::uint64_t done = 0;
      for (const auto& its : recorder.status().topics) {
        if (its.name == topic.name) done = its.messages;
      }
      return done == 10;
    }));
  }
  recorder.stop();
  Recording again(directory.file("again.mcap"));
  for (const char* topic : {"/notes", "/pictures"}) {
    CHECK(payloads(recording, topic).size() == 10);
    CHECK(payloads(recording, topic) == payloads(again, topic));
  }
}

TEST_CASE("a loan of another type is filled if its fields are the same") {
  const Directory directory;
  Recording recording(record(directory));
  ShmEngine engine(fresh());
  AnyPusher alike = engine.advertise_any("/alike", AnyType::of<OtherNote>());
  AnyPusher unlike = engine.advertise_any("/unlike", AnyType::of<Unlike>());
  RecordingQuery query;
  query.topics = {"/notes"};
  auto messages = recording.messages(query);
  (void)messages.next();
  const auto second = messages.next();
  AnyLoan loan = alike.loan();
  second->copy_to(loan);
  CHECK(loan.root().value()["number"].as<std::uint64_t>() == 1);
  CHECK(error_of([&] { second->copy_to(unlike.loan()); }).first == EINVAL);
  CHECK_FALSE(record::is_like(AnyType::of<Chained>(), "uint64 number\n"));
}

// ---- files of others
// ------------------------------------------------------------------------------

TEST_CASE("a file of another program is decoded by its schema") {
  const Directory directory;
  Recording recording(file_of_others(directory, "# a comment\nuint64 n  # how many\n"));
  CHECK(recording.topics()[0].objection.empty());
  auto messages = recording.messages();
  CHECK(messages.next()->root()["n"].as<std::uint64_t>() == 1);
  const auto second = messages.next();
  ShmEngine engine(fresh());
  AnyPusher pusher = engine.advertise_any("/count", second->type());
  AnyLoan loan = pusher.loan();
  second->copy_to(loan);
  CHECK(to_string(loan.root().value()) == "{n: 2}");
}

TEST_CASE("what cannot be decoded is said, and its bytes can be read all the same") {
  const Directory directory;
  const auto objection = [](const std::string& text, const std::string& message_encoding = "cdr",
                            const std::string& schema_encoding = "ros2msg") {
    const Directory its;
    return objection_to(file_of_others(its, text, message_encoding, schema_encoding));
  };
  CHECK(objection("uint64 n\n").empty());
  CHECK(objection("{}", "json", "jsonschema").find("json, not cdr") != std::string::npos);
  CHECK(objection("x", "cdr", "ros2idl").find("ros2idl") != std::string::npos);
  CHECK(objection("Unknown n\n").find("Unknown is not in it") != std::string::npos);
  CHECK(objection("wstring n\n").find("wstring") != std::string::npos);
  CHECK(objection("uint64\n").find("line 1") != std::string::npos);
  CHECK(objection("Count n\n").find("within itself") != std::string::npos);
  CHECK(objection("uint8 a\nuint8 a\n").find("line 2") != std::string::npos);
  for (const char* name : {"a:uint8,b", "1", "a-b", "n\x80"}) {
    CHECK(objection("uint64 " + std::string(name) + "\n").find("no name") != std::string::npos);
  }
  std::string many = "uint64 n\n";
  for (int i = 0; i < 2000; ++i) many += "===\nMSG: p/T" + std::to_string(i) + "\nuint8 n\n";
  CHECK(objection(many).find("1024 types") != std::string::npos);
  CHECK(objection("uint8[0] n\n").find("array of 0") != std::string::npos);
  CHECK(objection("uint8[18446744073709551616] n\n").find("array of") != std::string::npos);
  Recording recording(file_of_others(directory, "{}", "json", "jsonschema"));
  const auto message = recording.messages().next();
  REQUIRE(message);
  CHECK(message->payload().size() == 12);
  auto messages = recording.messages();
  const auto again = messages.next();
  CHECK(error_of([&] { (void)again->root(); }).first == EINVAL);
  CHECK(error_of([&] { (void)recording.type_of(recording.topics()[0]); }).first == EINVAL);
}

TEST_CASE("two fields are not taken for one whose name looks like both") {
  CHECK(record::are_alike("uint8 a\nuint8 b\n", "uint8 a\nbyte b  # the same\n"));
  CHECK_FALSE(record::are_alike("uint8 a\nuint8 b\n", "uint8 a:uint8,b\n"));
}

TEST_CASE("metadata that does not say what the schema says is not believed") {
  const Directory directory;
  const mcap::Pairs lies = record::pairs_of(AnyType::of<Picture>());
  Recording recording(file_of_others(directory, "uint64 n\n", "cdr", "ros2msg", lies));
  CHECK(recording.topics()[0].objection.empty());
  auto messages = recording.messages();
  CHECK(messages.next()->root()["n"].as<std::uint64_t>() == 1);
}

TEST_CASE("metadata of a type that cannot be is an objection") {
  for (const char* key : {"lot.size", "lot.align", "lot.identity", "lot.description"}) {
    for (const char* value : {"", "x", "0", "3", "99999999999999999999", "-1"}) {
      const Directory directory;
      mcap::Pairs pairs = record::pairs_of(AnyType::of<Note>());
      pairs[key] = value;
      const bool is_well = std::string(key) == "lot.identity" && *value >= '0' && *value <= '3';
      const std::string path =
          file_of_others(directory, "uint64 number\n", "cdr", "ros2msg", pairs);
      CHECK((objection_to(path).empty()) == is_well);
    }
  }
}

TEST_CASE("all that a .msg can say is read") {
  const record::SchemaType made = record::read_schema("pkg/msg/All",
                                                      R"(# begin
int32 ONE=1
string TEXT = "a # in it"
bool flag true
byte raw
char letter
float32[3] three
float64[] many
uint16[<=4] bounded
string<=10 name "default"
string[] names
Header header
other/Point[2] points
builtin_interfaces/Time stamp
===============================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===============================================================================
MSG: other/Point
float64 x
float64 y
)");
  CHECK(made.fields ==
        "{flag:bool,raw:uint8,letter:uint8,three:[3]float32,many:[]float64,bounded:[]uint16,"
        "name:string,names:[]string,header:{stamp:{sec:int32,nanosec:uint32,},frame_id:string,},"
        "points:[2]{x:float64,y:float64,},stamp:{sec:int32,nanosec:uint32,},}");
  CHECK(made.align == 8);
}

TEST_CASE("a schema that no message can have is refused by its line and the reason") {
  const auto why = [](const std::string& text) -> std::string {
    try {
      (void)record::type_of_schema("p/msg/T", text);
      return "";
    } catch (const Error& e) {
      const std::string said = e.what();
      const auto begin = said.find("line ");
      return said.substr(begin, said.rfind(" (") - begin);
    }
  };
  const std::vector<std::pair<std::string, std::string>> refused = {
      {"uint8", "line 1 of its schema: a type without a name: uint8"},
      {"# a comment\n\nuint8 1a", "line 3 of its schema: no name of a field: 1a"},
      {"uint8 a-b", "line 1 of its schema: no name of a field: a-b"},
      {"uint8[ a", "line 1 of its schema: [ without ]"},
      {"uint8[0] a", "line 1 of its schema: an array of 0"},
      {"uint8[x] a", "line 1 of its schema: an array of x"},
      {"uint8[3x] a", "line 1 of its schema: an array of 3x"},
      {"uint8[4294967296] a", "line 1 of its schema: an array of 4294967296"},
      {"uint8 a\nA[4294967295] b\n===\nMSG: p/A\nfloat64[4294967295] c",
       "line 2 of its schema: an array that is too large"},
      {"wstring s", "line 1 of its schema: a wstring, which no message of LOT can have"},
      {"other/Thing t", "line 1 of its schema: the type other/Thing is not in it"},
      {"uint8 a\nint8 a", "line 2 of its schema: two fields are called a"},
      {"===\nuint8 a",
       "line 2 of its schema: fields behind ===, and no line MSG: that names their type"},
      {"T t", "line 1 of its schema: p/T lies within itself"},
      {"A a\n===\nMSG: p/A\nT t", "line 4 of its schema: p/T lies within itself"},
  };
  for (const auto& [text, reason] : refused) {
    CAPTURE(text);
    CHECK(why(text) == reason);
  }
  for (const char* good : {"", "uint8[4294967295] a", "uint8 A=3\nuint8 a", "uint8[<=3] a"}) {
    CAPTURE(good);
    CHECK(why(good) == "");
  }
  const auto many = [](std::size_t count, const std::string& before, const std::string& behind) {
    std::string text;
    for (std::size_t i = 0; i < count; ++i) text += before + std::to_string(i) + behind;
    return text;
  };
  const std::string is_large =
      "it is larger than 16 KiB as a description, or has more than 16 levels";
  CHECK(why(many(4097, "uint8 f", "\n")) == "line 4097 of its schema: more than 4096 fields");
  CHECK(why(many(4096, "uint8 f", "\n")) == "line 4096 of its schema: " + is_large);
  CHECK(why(many(1023, "MSG: p/A", "\n")) == "");
  CHECK(why(many(1024, "MSG: p/A", "\n")) == "line 1024 of its schema: more than 1024 types");
  std::string deep = "A0 a\n";
  for (int i = 0; i < 40; ++i) {
    deep += "MSG: p/A" + std::to_string(i) + "\nA" + std::to_string(i + 1) + " a\n";
  }
  CHECK(why(deep + "MSG: p/A40\nuint8 a\n").ends_with("types that lie too deep in each other"));
}

TEST_CASE("types by chance: their schema gives a type whose messages have the same bytes") {
  std::mt19937_64 random(seed());
  Heap heap(16 << 20);
  codec::Encoded bytes;
  int made_types = 0;
  for (int i = 0; i < 60; ++i) {
    const Description type = RandomType(random, "t" + std::to_string(i)).take();
    const codec::Schema schema = codec::schema_of(type);
    heap.clear();
    const MutableValue message = heap.make(type);
    RandomValues(random).fill(message);
    encode(codec::Program(type), message, bytes);
    const std::string payload = joined(bytes.pieces());
    AnyType made;
    try {
      made = record::type_of_schema(schema.name, schema.msg);
    } catch (const Error&) {
      // Larger than a description may be, or deeper.
      continue;
    }
    CHECK(record::are_alike(schema.msg, codec::schema_of(made.description()).msg));
    const codec::Program program(made.description());
    const MutableValue other = heap.make(made.description());
    decode(program, {reinterpret_cast<const std::byte*>(payload.data()), payload.size()}, other);
    encode(program, other, bytes);
    CHECK(joined(bytes.pieces()) == payload);
    ++made_types;
  }
  CHECK(made_types > 20);
}

// ---- damage
// ---------------------------------------------------------------------------------------

TEST_CASE("a file that is cut at any byte: an error, or the messages that are whole") {
  const Directory directory;
  const std::string path = file_of_others(directory, "uint64 n\n");
  const std::string whole = read_file(path);
  const std::string cut = directory.file("cut.mcap");
  std::size_t last = 0;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    write_file(cut, std::string_view(whole).substr(0, size));
    try {
      Recording recording(cut);
      CHECK(recording.damage().is_cut);
      auto messages = recording.messages();
      std::size_t n = 0;
      while (const auto message = messages.next()) {
        CHECK(message->root()["n"].as<std::uint64_t>() == ++n);
      }
      CHECK(n >= last);
      last = n;
    } catch (const Error& e) {
      CHECK(last == 0);
      CHECK(e.error_number() == EINVAL);
    }
  }
  CHECK(last == 3);
}

TEST_CASE("any byte that is wrong: an error, an objection, or fewer messages") {
  const Directory directory;
  const std::string path = file_of_others(directory, "uint64 n\n");
  const std::string whole = read_file(path);
  const std::string spoilt = directory.file("spoilt.mcap");
  for (std::size_t at = 0; at < whole.size(); ++at) {
    std::string bytes = whole;
    bytes[at] = static_cast<char>(bytes[at] ^ (1 << (at % 8)));
    write_file(spoilt, bytes);
    try {
      Recording recording(spoilt);
      auto messages = recording.messages();
      while (const auto message = messages.next()) {
        if (message->topic().objection.empty()) (void)to_string(message->root());
      }
    } catch (const Error&) {
      continue;
    }
  }
}

TEST_CASE("what was missed is known of a file that was not closed, by its numbers") {
  const Directory directory;
  const std::string path = directory.file();
  {
    mcap::WriterOptions how;
    how.header.library = "lot 0.1.0";
    mcap::Writer writer(path, how);
    mcap::Channel channel;
    channel.topic = "/gaps";
    const std::uint16_t id = writer.add(channel);
    for (const std::uint32_t sequence : {5U, 6U, 9U, 10U}) {
      writer.write({id, sequence, sequence, sequence}, {});
    }
    writer.flush();
    std::filesystem::copy_file(path, directory.file("killed.mcap"));
  }
  const Recording recording(directory.file("killed.mcap"));
  CHECK(recording.topics().at(0).messages == 4);
  CHECK(recording.topics().at(0).missed == 2);
  CHECK(recording.damage().is_cut);
}

TEST_CASE("what is no recording is refused") {
  const Directory directory;
  CHECK(error_of([&] { Recording(directory.file("none")); }).first == ENOENT);
  write_file(directory.file("text"), "#ROSBAG V2.0\n and more than a few bytes of it");
  CHECK(error_of([&] { Recording(directory.file("text")); }).first == EINVAL);
  write_file(directory.file("empty"), "");
  CHECK(error_of([&] { Recording(directory.file("empty")); }).first == EINVAL);
  CHECK(error_of([&] { Recording(std::vector<std::string>()); }).first == EINVAL);
}

}  // namespace
}  // namespace lot::testing
