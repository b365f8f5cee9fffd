// SPDX-License-Identifier: Apache-2.0
#include "python/queue.hpp"

#include <optional>
#include <utility>

#include <pybind11/stl.h>

#include "python/gil.hpp"
#include "python/loans.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

/// What look(end) finds, which waits until `end`; without an end it looks once.
template <class Found, class Look>
Found find(Seconds timeout, Look&& look) {
  Found found;
  if (timeout && *timeout <= 0) {
    const Released release;
    found = look(std::optional<Deadline>());
    return found;
  }
  wait(deadline_after(timeout), [&](Clock::time_point end) {
    found = look(std::optional<Deadline>(end));
    return found ? Status::Ok : Status::Timeout;
  });
  return found;
}

}  // namespace

py::object Queue::loan(const py::kwargs& fields) {
  return build([its = its_] { return loan_of(*its); }, fields);
}

bool Queue::put(const Part& part, Seconds timeout) {
  const auto its = its_;  // also while the last reference goes in another thread
  Taken taken(part);
  if (!may_wait_ || (timeout && *timeout <= 0)) {
    const Released release;
    return its->try_put(std::move(taken.loan())) == Status::Ok;
  }
  return wait(deadline_after(timeout), [&](Clock::time_point end) {
           return its->put_until(std::move(taken.loan()), Deadline(end));
         }) == Status::Ok;
}

py::object Queue::pop(Seconds timeout) {
  auto found = find<AnyMessage>(timeout, [its = its_](std::optional<Deadline> end) {
    return end ? its->wait_and_pop_until(*end) : its->try_pop();
  });
  if (!found) return py::none();
  return to_object(Part(std::make_shared<Held>(std::move(found))));
}

Task Queue::take(Seconds timeout) {
  return Task(find<AnyTask>(timeout, [its = its_](std::optional<Deadline> end) {
    return end ? its->wait_and_take_until(*end) : its->try_take();
  }));
}

namespace {

void define_task(py::module_& module) {
  py::class_<Task>(module, "Task",
                   "A task that this process works on. At the end of its `with` it is done, but\n"
                   "another worker gets it where an exception passes, or the process dies.")
      .def("__enter__",
           [](const py::object& self) {
             return self.cast<const Task&>().has_item() ? self : py::object(py::none());
           })
      .def("__bool__", &Task::has_item)
      .def("__exit__",
           [](Task& its, const py::object& type, const py::object&, const py::object&) {
             if (!its.is_open()) return;
             if (type.is_none()) {
               its.finish();
             } else {
               its.give_back();
             }
           })
      .def("finish", &Task::finish, "The task is done: no worker gets it any more.")
      .def("give_back", &Task::give_back, "Another worker may do it, or this one later.")
      .def_property_readonly("item", &Task::item, "What is to be done.")
      .def_property_readonly("deliveries", &Task::deliveries,
                             "How often workers have got it, with this time; 0 after its end.");
}

}  // namespace

void define_queue(py::module_& module) {
  define_task(module);
  py::class_<Queue>(module, "Queue",
                    "A queue whose items are each taken by one reader, in any process. Any thread.")
      .def("loan", &Queue::loan,
           "A new item in shared memory, with these fields set: numbers are zero, else empty.")
      .def("put", &Queue::put, py::arg("item"), py::arg("timeout") = py::none(),
           "Puts a loan, and waits for a place: seconds; None: for ever; 0: not. False: the queue\n"
           "is full, and the loan is still the caller's.")
      .def("pop", &Queue::pop, py::arg("timeout") = py::none(),
           "The next item, which lives as long as any part or view of it. None: nothing came.")
      .def("take", &Queue::take, py::arg("timeout") = py::none(),
           "The next task of a queue with redeliver: `with queue.take() as task`. None there, and\n"
           "False: nothing came.")
      .def(
          "listen",
          [](const Queue& its) {
            const Released release;
            its.its()->listen();
          },
          "Begins to read.")
      .def(
          "size",
          [](const Queue& its) {
            const Released release;
            return its.its()->size();
          },
          "Items that could be had now.")
      .def(
          "fileno",
          [](const Queue& its) {
            const Released release;
            return its.its()->fd();
          },
          "A descriptor for select and asyncio: readable until a look with timeout 0 finds "
          "nothing.")
      .def_property_readonly(
          "capacity", [](const Queue& its) { return its.its()->capacity(); },
          "Items of one handle that wait in it at most.")
      .def_property_readonly(
          "type", [](const Queue& its) { return its.its()->type(); }, "What an item is.");
}

}  // namespace lot::python
