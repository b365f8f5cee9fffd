// SPDX-License-Identifier: Apache-2.0
/// What lot_test.py meets on its topics: a program in C++ with the types of its classes.
///
///     peer types    prints each type: its name, size, alignment and hashes
///     peer send     publishes points, in slots and in blocks, and a box; waits for a box in return
///     peer items    pops a job of /items, puts two points into /points
///     peer tasks    does one task of /tasks, and is killed at work on the next
///     peer serve    answers /frame: a Job's number is the size of the Frame; until its input ends
///     peer call     asks /frame for one of 3 bytes, and for one that cannot be made
///     peer record FILE    records /topic until its standard input ends
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <stdexcept>
#include <string_view>
#include <thread>
#include <utility>

#include <lot/lot.hpp>
#include <lot/recorder.hpp>

enum class Mode : std::uint16_t { Idle = 0, Moving = 7 };

struct Point {
  std::uint8_t flag = 0;
  double x = 0;
  std::int16_t counts[3] = {};
  float y = 0;
};

struct Frame {
  std::uint32_t height = 0, width = 0;
  lot::ShmVector<std::uint8_t> data;
};

struct Job {
  std::int32_t number = 0;
  lot::ShmString text;
};

namespace robot {

struct Box {
  lot::ShmString label;
  Mode mode = Mode::Idle;
  lot::ShmVector<float> scores;
  lot::ShmVector<Point> points;
  lot::ShmVector<lot::ShmString> names;
  lot::ShmVector<lot::ShmVector<std::uint8_t>> rows;
  std::array<std::array<std::uint16_t, 2>, 3> grid = {};
  lot::ShmRef<const Point> home;
  bool is_good = false;
};

}  // namespace robot

namespace {

using namespace std::chrono_literals;

template <class T>
void print_type() {
  const lot::AnyType type = lot::AnyType::of<T>();
  std::printf("%s %zu %zu %llu %llu\n", type.name().c_str(), type.size(), type.alignment(),
              static_cast<unsigned long long>(type.description().layout_hash()),
              static_cast<unsigned long long>(type.description().names_hash()));
}

bool push_points(lot::ShmEngine& engine, const char* topic, bool fast_lane,
                 const lot::StopToken& stop) {
  lot::PusherOptions options;
  options.fast_lane = fast_lane;
  auto points = engine.advertise<Point>(topic, options);
  if (!points.wait_for_readers(1, stop)) return false;
  for (int i = 0; i < 3; ++i) {
    auto point = points.loan();
    point->x = i + 0.5;
    point->counts[2] = -3;
    if (points.push(std::move(point)) != lot::Status::Ok) return false;
  }
  return true;
}

bool push_box(lot::ShmEngine& engine, const lot::StopToken& stop) {
  auto boxes = engine.advertise<robot::Box>("/box");
  if (!boxes.wait_for_readers(1, stop)) return false;
  auto home = engine.make<Point>();
  home->x = 42;
  auto box = boxes.loan();
  box->label = "left \xc3\xa9";
  box->mode = Mode::Moving;
  box->scores.assign({0.5F, 1.5F, 2.5F});
  box->points.resize(2);
  box->points[0].x = 1.0;
  box->points[1].x = 2.5;
  box->names.resize(2);
  box->names[0] = "a";
  box->names[1].assign(40, 'b');
  box->rows.resize(3);
  box->rows[0].assign({1, 2});
  box->rows[2].assign({3});
  box->grid = {{{1, 2}, {3, 4}, {5, 6}}};
  box->home = lot::ShmSharedPtr<const Point>(std::move(home));
  box->is_good = true;
  return boxes.push(std::move(box)) == lot::Status::Ok;
}

bool send() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto answers = engine.subscribe<robot::Box>("/answer");
  if (!push_points(engine, "/slots", true, stop) || !push_points(engine, "/blocks", false, stop) ||
      !push_box(engine, stop)) {
    return false;
  }
  const auto answer = answers.pull(stop);
  if (!answer || answer->names.size() != 2 || answer->rows.size() != 3) return false;
  std::printf("%s %u %g %g %zu %u %u\n", answer->label.c_str(), static_cast<unsigned>(answer->mode),
              static_cast<double>(answer->scores.at(2)), answer->points.at(1).x,
              answer->names[1].size(), unsigned{answer->rows[2].at(0)},
              unsigned{answer->grid[2][1]});
  return true;
}

bool items() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto jobs = engine.queue<lot::ShmUniquePtr<Job>>("/items");
  auto points = engine.queue<Point>("/points");
  const auto job = jobs.wait_and_pop(stop);
  if (!job) return false;
  std::printf("%d %s\n", (*job)->number, (*job)->text.c_str());
  Point point;
  for (const double x : {1.5, 2.5}) {
    point.x = x;
    if (points.put(point, stop) != lot::Status::Ok) return false;
  }
  return true;
}

bool tasks() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  lot::QueueOptions options;
  options.redeliver = true;
  auto jobs = engine.queue<lot::ShmUniquePtr<Job>>("/tasks", options);
  auto first = jobs.wait_and_take(stop);
  if (!first) return false;
  std::printf("%d\n", first->number);
  std::fflush(stdout);
  first.finish();
  const auto second = jobs.wait_and_take(stop);
  if (second) std::raise(SIGKILL);
  return false;
}

void wait_for_end_of_input() {
  std::puts("ready");
  std::fflush(stdout);
  while (std::getchar() != EOF) {
  }
}

bool serve() {
  lot::ShmEngine engine;
  const auto server = engine.serve<Job, Frame>("/frame", [](const Job& job, Frame& frame) {
    if (job.number < 0) throw std::runtime_error("no frame is so small");
    frame.width = static_cast<std::uint32_t>(job.text.size());
    frame.data.assign(static_cast<std::size_t>(job.number), 7);
  });
  wait_for_end_of_input();
  return true;
}

bool call() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto client = engine.client<Job, Frame>("/frame");
  auto request = client.loan();
  request->number = 3;
  request->text = "longer than what a string has in its own bytes";
  const auto frame = client.call(std::move(request), stop);
  if (!frame) return false;
  std::printf("%u %zu\n", frame->width, frame->data.size());
  auto wrong = client.loan();
  wrong->number = -1;
  try {
    (void)client.call(std::move(wrong), stop);
  } catch (const lot::Error& error) {
    std::printf("%d\n", error.error_number() == EREMOTEIO ? 1 : 0);
  }
  return true;
}

bool record(const char* file) {
  lot::RecorderOptions options;
  options.path = file;
  options.topics = {"/topic"};
  lot::Recorder recorder(options);
  while (recorder.status().topics.empty()) std::this_thread::sleep_for(1ms);
  wait_for_end_of_input();
  recorder.stop();
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const std::string_view what = argc > 1 ? argv[1] : "send";
    if (what == "types") {
      print_type<Point>();
      print_type<Frame>();
      print_type<robot::Box>();
      return 0;
    }
    if (what == "items") return items() ? 0 : 1;
    if (what == "tasks") return tasks() ? 0 : 1;
    if (what == "serve") return serve() ? 0 : 1;
    if (what == "call") return call() ? 0 : 1;
    if (what == "record" && argc == 3) return record(argv[2]) ? 0 : 1;
    return send() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "peer: %s\n", error.what());
    return 1;
  }
}
