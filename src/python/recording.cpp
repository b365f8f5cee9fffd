// SPDX-License-Identifier: Apache-2.0
#include "python/recording.hpp"

#include <cerrno>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <pybind11/stl.h>

#include "lot/error.hpp"
#include "lot/recording.hpp"

#include "python/gil.hpp"
#include "python/part.hpp"
#include "python/waits.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

std::int64_t count_of(RecordedTime time) { return time.time_since_epoch().count(); }

/// One text, or each of a sequence. Throws TypeError, which says what `what` is.
std::vector<std::string> texts_of(const py::object& given, const char* what) {
  const auto text_of = [&](const py::object& one) {
    const auto path = py::reinterpret_steal<py::object>(PyOS_FSPath(one.ptr()));
    if (!path || !py::isinstance<py::str>(path)) {
      PyErr_Clear();
      throw py::type_error(std::string(what) + ", not " + py::repr(one).cast<std::string>());
    }
    return path.cast<std::string>();
  };
  if (!py::isinstance<py::list>(given) && !py::isinstance<py::tuple>(given))
    return {text_of(given)};
  std::vector<std::string> texts;
  for (const auto one : given) texts.push_back(text_of(py::reinterpret_borrow<py::object>(one)));
  return texts;
}

RecordedTime time_of(std::optional<std::int64_t> count, RecordedTime otherwise) {
  return count ? RecordedTime(std::chrono::nanoseconds(*count)) : otherwise;
}

/// A recording, and whether a thread reads it just now.
struct Opened {
  explicit Opened(const std::vector<std::string>& paths) : recording(paths) {}

  Recording recording;
  bool is_used = false;
};

/// What is read of it, one message at a time.
struct Reading {
  Reading(std::shared_ptr<Opened> from, RecordedMessages what)
      : opened(std::move(from)), messages(std::move(what)) {}

  std::shared_ptr<Opened> opened;
  RecordedMessages messages;
  std::uint64_t number = 0;  ///< of the message that is there
};

/// Threads: under the GIL.
class Message {
 public:
  Message(std::shared_ptr<Reading> reading, const RecordedMessage& message)
      : reading_(std::move(reading)), message_(message), number_(reading_->number) {}

  const std::string& topic() const noexcept { return message_.topic().name; }
  std::int64_t log_time() const noexcept { return count_of(message_.log_time()); }
  std::int64_t publish_time() const noexcept { return count_of(message_.publish_time()); }
  std::uint32_t sequence() const noexcept { return message_.sequence(); }
  py::bytes payload() const {
    const Use use(current(), "recording");
    const Bytes bytes = message_.payload();
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }
  AnyType type() const {
    const Use use(current(), "recording");
    return message_.type();
  }
  /// Decoded into memory that the next message uses again: so this is a copy.
  py::object message() const {
    const Use use(current(), "recording");
    const auto held = std::make_shared<Held>(message_.root(), message_.type());
    const struct End {
      Held& held;
      ~End() { held.end(); }
    } end{*held};
    return Part(held).copy();
  }
  void copy_to(const Part& loan) const {
    loan.require_whole();
    const Use use(current(), "recording");
    message_.copy_to(loan.held()->filling());
  }

 private:
  bool& current() const {
    if (reading_->number != number_) {
      throw py::value_error("the recording has gone on to the next message");
    }
    return reading_->opened->is_used;
  }

  std::shared_ptr<Reading> reading_;
  RecordedMessage message_;
  std::uint64_t number_;
};

class Messages {
 public:
  explicit Messages(std::shared_ptr<Reading> reading) : reading_(std::move(reading)) {}

  Message next() {
    const auto reading = reading_;
    const Use use(reading->opened->is_used, "recording");
    ++reading->number;
    std::optional<RecordedMessage> found;
    {
      const Released release;
      found = reading->messages.next();
    }
    if (!found) throw py::stop_iteration();
    return {reading, *found};
  }

 private:
  std::shared_ptr<Reading> reading_;
};

/// Threads: under the GIL.
class Recorded {
 public:
  explicit Recorded(const std::vector<std::string>& paths) {
    const Released release;
    opened_ = std::make_shared<Opened>(paths);
  }

  Messages messages(const py::object& topics, std::optional<std::int64_t> from,
                    std::optional<std::int64_t> until) {
    const Use use(opened_->is_used, "recording");
    RecordingQuery query;
    query.topics = texts_of(topics, "topics: a name or a list of names");
    query.from = time_of(from, query.from);
    query.until = time_of(until, query.until);
    return Messages(std::make_shared<Reading>(opened_, opened_->recording.messages(query)));
  }
  const std::vector<RecordedTopic>& topics() const { return opened_->recording.topics(); }
  std::int64_t begin() const { return count_of(opened_->recording.begin()); }
  std::int64_t end() const { return count_of(opened_->recording.end()); }
  AnyType type_of(const py::object& topic) const {
    const Use use(opened_->is_used, "recording");
    if (py::isinstance<RecordedTopic>(topic)) {
      return opened_->recording.type_of(topic.cast<const RecordedTopic&>());
    }
    const std::string name = texts_of(topic, "topic: a RecordedTopic or a name").at(0);
    for (const RecordedTopic& its : topics()) {
      if (its.name == name) return opened_->recording.type_of(its);
    }
    throw Error(ENOENT, name, "the recording has no such topic", "look at its topics");
  }
  RecordingDamage damage() const {
    const Use use(opened_->is_used, "recording");
    return opened_->recording.damage();
  }

 private:
  std::shared_ptr<Opened> opened_;
};

void define_topic(py::module_& module) {
  py::class_<RecordedTopic>(module, "RecordedTopic", "What a recording has of a topic.")
      .def_readonly("name", &RecordedTopic::name, "The topic.")
      .def_readonly("type_name", &RecordedTopic::type, "Of its messages, as the schema is called.")
      .def_readonly("encoding", &RecordedTopic::encoding, "Of its messages: 'cdr'.")
      .def_readonly("schema", &RecordedTopic::schema, "The text that says what they are.")
      .def_readonly("messages", &RecordedTopic::messages, "How many there are.")
      .def_readonly("missed", &RecordedTopic::missed, "By the recorder, before it looked.")
      .def_readonly("lost", &RecordedTopic::lost, "Could not be written.")
      .def_readonly("left_out", &RecordedTopic::left_out, "Beyond a rate.")
      .def_readonly("objection", &RecordedTopic::objection,
                    "Why its messages cannot be decoded; '': they can be.");
  py::class_<RecordingDamage>(module, "RecordingDamage", "What was skipped: it cannot be read.")
      .def_readonly("chunks", &RecordingDamage::chunks, "Pieces with messages.")
      .def_readonly("records", &RecordingDamage::records, "Others.")
      .def_readonly("bytes", &RecordingDamage::bytes, "Of all of it.")
      .def_readonly("first", &RecordingDamage::first, "The first reason; '': nothing was skipped.")
      .def_readonly("is_cut", &RecordingDamage::is_cut, "A file was not closed by its recorder.");
}

void define_message(py::module_& module) {
  py::class_<Message>(module, "RecordedMessage",
                      "A message of a recording. What it says of its content (payload, type,\n"
                      "message, copy_to) it says until the loop goes on.")
      .def_property_readonly("topic", &Message::topic, "The name of its topic.")
      .def_property_readonly("log_time_ns", &Message::log_time,
                             "When it was recorded: nanoseconds since 1970.")
      .def_property_readonly("publish_time_ns", &Message::publish_time,
                             "When it was published, where the file says so.")
      .def_property_readonly("sequence", &Message::sequence, "Counts its topic's messages.")
      .def_property_readonly("payload", &Message::payload, "Its bytes, as in the file: a copy.")
      .def_property_readonly("type", &Message::type, "What it is decoded as.")
      .def_property_readonly("message", &Message::message,
                             "The message in plain Python, decoded by each look: a copy.")
      .def("copy_to", &Message::copy_to, py::arg("loan"),
           "Makes a loan this message, to be pushed.");
  py::class_<Messages>(module, "RecordedMessages", "The messages that were asked for.")
      .def("__iter__", [](const py::object& self) { return self; })
      .def("__next__", &Messages::next);
}

}  // namespace

void define_recording(py::module_& module) {
  define_topic(module);
  define_message(module);
  py::class_<Recorded>(module, "Recording",
                       "A recording: one MCAP file, or the files of one that was split.")
      .def(py::init([](const py::object& path) {
             return std::make_unique<Recorded>(texts_of(path, "path: a path or a list of paths"));
           }),
           py::arg("path"))
      .def(
          "messages", &Recorded::messages, py::arg("topics") = py::tuple(),
          py::arg("from_ns") = py::none(), py::arg("until_ns") = py::none(),
          "The messages of a topic, or of a list of topics (names, and patterns of a shell; none:\n"
          "all) in the order of their log times, from a time to a time, both included.")
      .def("__iter__",
           [](Recorded& its) { return its.messages(py::tuple(), std::nullopt, std::nullopt); })
      .def_property_readonly("topics", &Recorded::topics, "What it has.")
      .def_property_readonly("begin_ns", &Recorded::begin, "The first log time.")
      .def_property_readonly("end_ns", &Recorded::end, "The last log time.")
      .def(
          "type_of", &Recorded::type_of, py::arg("topic"),
          "The type of a topic's messages, for Engine.advertise(): of a RecordedTopic, or by name.")
      .def("damage", &Recorded::damage, "What was skipped so far.");
}

}  // namespace lot::python
