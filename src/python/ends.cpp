// SPDX-License-Identifier: Apache-2.0
#include "python/ends.hpp"

#include <memory>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

#include <pybind11/stl.h>

#include "lot/engine.hpp"
#include "lot/signals.hpp"

#include "python/gil.hpp"
#include "python/loans.hpp"
#include "python/part.hpp"
#include "python/queue.hpp"
#include "python/recording.hpp"
#include "python/service.hpp"
#include "python/subscriber.hpp"
#include "python/wait_set.hpp"
#include "python/waits.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

class Publisher {
 public:
  Publisher(AnyPusher pusher, const PusherOptions& options)
      : its_(std::make_shared<AnyPusher>(std::move(pusher))),
        policy_(options.policy),
        block_for_(options.block_for) {}

  py::object loan(const py::kwargs& fields) {
    return build([its = its_] { return loan_of(*its); }, fields);
  }

  /// False: Status::Full, and the message is still the caller's.
  bool push(const Part& part, std::optional<double> block_for) {
    const auto its = its_;
    if (!part.held()->is_loan()) {
      const AnyMessage message = part.message();
      return push_until(block_for,
                        [&](std::chrono::nanoseconds time) { return its->push(message, time); });
    }
    Taken taken(part);
    return push_until(block_for, [&](std::chrono::nanoseconds time) {
      return its->push(std::move(taken.loan()), time);
    });
  }

  AnyPusher& pusher() const noexcept { return *its_; }

 private:
  template <class Push>
  bool push_until(std::optional<double> block_for, Push&& push) const {
    const bool waits = policy_ == Policy::Block;
    const double limit = block_for ? *block_for : std::chrono::duration<double>(block_for_).count();
    const auto deadline = waits ? deadline_after(limit) : Clock::now();
    return wait(deadline, [&](Clock::time_point end) {
             return push(std::max(end - Clock::now(), Clock::duration::zero()));
           }) == Status::Ok;
  }

  std::shared_ptr<AnyPusher> its_;
  Policy policy_;
  std::chrono::nanoseconds block_for_;
};

class Engine {
 public:
  explicit Engine(const EngineOptions& options) : engine_(options) {}

  Publisher advertise(const std::string& topic, const AnyType& type, const PusherOptions& options) {
    const Released release;
    return {engine_.advertise_any(topic, type, options), options};
  }
  Subscriber subscribe(const std::string& topic, const std::optional<AnyType>& type,
                       const PullerOptions& options) {
    const Released release;
    return Subscriber(type ? engine_.subscribe_any(topic, *type, options)
                           : engine_.subscribe_any(topic, options));
  }
  std::optional<AnyType> type_of(const std::string& topic) {
    const Released release;
    AnyType found = engine_.type_of(topic);
    if (!found) return std::nullopt;
    return found;
  }
  py::object make(const AnyType& type, const py::kwargs& fields) {
    return build([&] { return engine_.make_any(type); }, fields);
  }
  Queue queue(const std::string& name, const AnyType& type, const QueueOptions& options) {
    const Released release;
    return {engine_.queue_any(name, type, options), options.policy == Policy::Block};
  }
  Ticket ticket() { return Ticket(engine_); }
  const std::string& path() const { return engine_.path(); }

 private:
  ShmEngine engine_;
};

/// Of the names that EngineOptions has. Throws TypeError, and as ShmEngine.
std::unique_ptr<Engine> join(const py::kwargs& given) {
  EngineOptions options;
  const py::dict left = given.attr("copy")();
  const auto take = [&left](const char* name, auto& option) {
    using Option = std::decay_t<decltype(option)>;
    if (!left.contains(name)) return;
    const py::object value = left.attr("pop")(name);
    try {
      option = value.template cast<Option>();
    } catch (const py::cast_error&) {
      const char* const takes = std::is_same_v<Option, bool>          ? "True or False"
                                : std::is_same_v<Option, std::string> ? "a str"
                                                                      : "a number of 0 or more";
      throw py::type_error(std::string(name) + ": takes " + takes + ", not " +
                           py::repr(value).cast<std::string>());
    }
  };
  take("segment", options.segment);
  take("directory", options.directory);
  take("size_bytes", options.size_bytes);
  take("permissions", options.permissions);
  take("group", options.group);
  take("user", options.user);
  take("persist", options.persist);
  take("lock_memory", options.lock_memory);
  take("name", options.name);
  take("processes", options.processes);
  take("blocks", options.blocks);
  take("topics", options.topics);
  take("channels", options.channels);
  take("readers", options.readers);
  if (!left.empty()) {
    const auto name = py::str(left.attr("popitem")().attr("__getitem__")(0)).cast<std::string>();
    throw py::type_error("an engine has no option '" + name + "'");
  }
  const Released release;
  return std::make_unique<Engine>(options);
}

Publisher advertise(Engine& engine, const std::string& topic, const AnyType& type, Policy policy,
                    std::uint32_t depth, double block_for, std::optional<std::uint32_t> history,
                    std::uint64_t max_bytes, bool stamp, QueueEngine queue) {
  PusherOptions options;
  options.policy = policy;
  options.depth = depth;
  options.block_for = std::chrono::duration<double>(block_for);
  if (history) options.history = *history;
  options.max_bytes = max_bytes;
  options.stamp = stamp;
  options.engine = queue;
  return engine.advertise(topic, type, options);
}

Subscriber subscribe(Engine& engine, const std::string& topic, const std::optional<AnyType>& type,
                     Wait wait, std::uint64_t history, std::uint64_t max_held_bytes,
                     bool observer) {
  PullerOptions options;
  options.wait = wait;
  options.history = history;
  options.max_held_bytes = max_held_bytes;
  options.observer = observer;
  return engine.subscribe(topic, type, options);
}

Queue queue(Engine& engine, const std::string& name, const AnyType& type, std::uint32_t depth,
            Policy policy, bool redeliver, Wait wait, QueueEngine queue_engine) {
  QueueOptions options;
  options.depth = depth;
  options.policy = policy;
  options.redeliver = redeliver;
  options.wait = wait;
  options.engine = queue_engine;
  return engine.queue(name, type, options);
}

void define_engine(py::module_& module) {
  py::class_<Engine>(module, "Engine", "This process's place in a segment.")
      .def(py::init(&join),
           "Joins the segment, and makes it where there is none. Options, by name: segment,\n"
           "directory, size_bytes, permissions, group, user, persist, lock_memory, name; of a new\n"
           "segment: processes, blocks, topics, channels, readers. The environment's variables "
           "come\n"
           "first: LOT_SEGMENT is taken in place of segment, LOT_SIZE of size_bytes, and so on.")
      .def("_advertise", &advertise)
      .def("_subscribe", &subscribe)
      .def("_queue", &queue)
      .def("_make", &Engine::make)
      .def("_ticket", &Engine::ticket)
      .def("type_of", &Engine::type_of, py::arg("topic"),
           "What the topic carries; None where no process uses it.")
      .def("__repr__", [](const Engine& its) { return "<lot.Engine " + its.path() + ">"; })
      .def_property_readonly("path", &Engine::path, "The file that the segment is.");
}

void define_publisher(py::module_& module) {
  py::class_<Publisher>(module, "Publisher", "Publishes messages on a topic, from any thread.")
      .def("loan", &Publisher::loan,
           "A new message in shared memory, with these fields set: numbers are zero, else empty.")
      .def(
          "push", &Publisher::push, py::arg("message"), py::arg("block_for") = py::none(),
          "Publishes a loan, or a message that was received, without a copy. False: a slow reader\n"
          "holds the queue back, and the message is still the caller's.")
      .def(
          "readers", [](const Publisher& its) { return its.pusher().readers(); },
          "Subscribers that read it.")
      .def(
          "wait_for_readers",
          [](const Publisher& its, std::size_t count, Seconds timeout) {
            return wait(deadline_after(timeout), [&](Clock::time_point end) {
                     const auto left = std::max(end - Clock::now(), Clock::duration::zero());
                     return its.pusher().wait_for_readers(count, left) ? Status::Ok
                                                                       : Status::Timeout;
                   }) == Status::Ok;
          },
          py::arg("count") = 1, py::arg("timeout") = py::none(),
          "Waits until so many read it. False: the time is up.")
      .def(
          "reserve",
          [](const Publisher& its, std::size_t count, std::size_t bytes) {
            const Released release;
            its.pusher().reserve(count, bytes);
          },
          py::arg("count"), py::arg("bytes"), "Makes memory for so many messages now.")
      .def_property_readonly(
          "type", [](const Publisher& its) { return its.pusher().type(); }, "What it sends.");
}

void define_subscriber(py::module_& module) {
  py::class_<Borrow>(module, "Borrow", "A message that is looked at in place: for `with`.")
      .def("__enter__", &Borrow::message)
      .def("__exit__", [](Borrow& its, const py::args&) { its.end(); })
      .def("__bool__", &Borrow::has_message)
      .def("end", &Borrow::end, "Ends it early.");
  py::class_<Subscriber>(module, "Subscriber",
                         "Receives the messages of a topic. One thread at a time.")
      .def("borrow", &Subscriber::borrow, py::arg("timeout") = py::none(),
           "The next message in place: `with sub.borrow(0.1) as m`. m is None: nothing came. "
           "timeout\n"
           "in seconds; None: for ever; 0: now.")
      .def("pull", &Subscriber::pull, py::arg("timeout") = py::none(),
           "The next message, which lives as long as any part or view of it. None: nothing came.")
      .def(
          "envelope",
          [](const Subscriber& its) {
            return its.ask([](AnyPuller& puller) { return puller.envelope(); });
          },
          "Where the last message comes from.")
      .def(
          "publishers",
          [](const Subscriber& its) {
            return its.ask([](AnyPuller& puller) { return puller.publishers(); });
          },
          "Publishers of the topic.")
      .def(
          "size",
          [](const Subscriber& its) {
            return its.ask([](AnyPuller& puller) { return puller.size(); });
          },
          "Messages that are there to be read.")
      .def(
          "fileno",
          [](const Subscriber& its) {
            return its.ask([](AnyPuller& puller) { return puller.fd(); });
          },
          "A descriptor for select and asyncio: readable until a look with timeout 0 finds "
          "nothing.")
      .def_property_readonly(
          "status", [](const Subscriber& its) { return its.puller().status(); },
          "How the last look ended.")
      .def_property_readonly(
          "missed", [](const Subscriber& its) { return its.puller().missed(); },
          "Messages lost just before the last one.")
      .def_property_readonly(
          "missed_total", [](const Subscriber& its) { return its.puller().missed_total(); },
          "All that were lost.")
      .def_property_readonly(
          "type", [](const Subscriber& its) { return its.puller().type(); }, "What it gets.");
}

void define_envelope(py::module_& module) {
  py::class_<Envelope>(module, "Envelope", "Where a message comes from.")
      .def_readonly("sequence", &Envelope::sequence, "0 for the first of its publisher.")
      .def_readonly("missed", &Envelope::missed, "Messages missed just before it.")
      .def_readonly("publisher", &Envelope::publisher, "The name of its process.")
      .def_readonly("publisher_id", &Envelope::publisher_id, "Tells publishers apart.")
      .def_property_readonly(
          "pushed_ns",
          [](const Envelope& its) -> std::optional<std::int64_t> {
            if (!its.pushed) return std::nullopt;
            return std::chrono::nanoseconds(its.pushed->time_since_epoch()).count();
          },
          "When it was pushed, as time.monotonic_ns(); None: its publisher does not stamp.");
}

}  // namespace

void define_ends(py::module_& module) {
  py::enum_<Status>(module, "Status", "How a look ended.")
      .value("OK", Status::Ok)
      .value("EMPTY", Status::Empty)
      .value("FULL", Status::Full)
      .value("TIMEOUT", Status::Timeout)
      .value("PUBLISHER_GONE", Status::PublisherGone)
      .value("HOLDS_TOO_MUCH", Status::HoldsTooMuch)
      .value("STOPPED", Status::Stopped)
      .value("SERVER_GONE", Status::ServerGone);
  py::enum_<Policy>(module, "Policy", "What a push does where a reader is a whole queue behind.")
      .value("OVERWRITE", Policy::Overwrite)
      .value("BLOCK", Policy::Block)
      .value("REFUSE", Policy::Refuse);
  py::enum_<QueueEngine>(module, "QueueEngine", "How a queue works inside.")
      .value("RING", QueueEngine::Ring)
      .value("MUTEX", QueueEngine::Mutex);
  py::enum_<Wait>(module, "Wait", "How a subscriber passes the time.")
      .value("SPIN", Wait::Spin)
      .value("ADAPTIVE", Wait::Adaptive)
      .value("PARK", Wait::Park);
  define_envelope(module);
  define_queue(module);
  define_engine(module);
  define_publisher(module);
  define_subscriber(module);
  define_wait_set(module);
  define_recording(module);
  define_service(module);
  module.def(
      "end_cleanly_on_signals", &end_cleanly_on_signals,
      "SIGTERM and SIGHUP end the process as by default, but the last process of a segment\n"
      "leaves no file. A signal that has a handler (SIGINT, mostly) is left alone. A child of\n"
      "fork() calls it again.");
}

}  // namespace lot::python
