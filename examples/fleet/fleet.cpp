// SPDX-License-Identifier: Apache-2.0

// A robot in three boxes: cameras, a planner and an operator. Each box has a segment of its own,
// and lot_gateway between them (fleet.sh). The programs know nothing of that.
//
//     fleet cameras      images of 2 MiB on /camera/front, 30 a second
//     fleet planner      looks at them; /control, 400 a second; /map, latched
//     fleet operator     looks at /control and /map
//
// Each says at its end what has come: how late, and how much is missing.

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include <lot/lot.hpp>

namespace fleet {

struct Stamp {
  std::uint64_t number = 0;
  std::uint64_t pushed_ns = 0;  // steady clock: the boxes of this example are one machine
};
LOT_DESCRIBE(Stamp, number, pushed_ns)  // what ROS 2 calls the fields; C++20 needs no such lines

struct Image {
  Stamp stamp;
  lot::ShmVector<std::uint8_t> pixels;
};
LOT_DESCRIBE(Image, stamp, pixels)

struct Control {
  Stamp stamp;
  double speed = 0;
  double turn = 0;
};
LOT_DESCRIBE(Control, stamp, speed, turn)

struct Map {
  Stamp stamp;
  lot::ShmVector<std::uint8_t> cells;
};
LOT_DESCRIBE(Map, stamp, cells)

}  // namespace fleet

namespace {

using namespace std::chrono_literals;
using fleet::Control, fleet::Image, fleet::Map, fleet::Stamp;

constexpr std::size_t kImageBytes = 2 << 20;
constexpr std::size_t kMapBytes = 1 << 20;

std::uint64_t now_ns() {
  return static_cast<std::uint64_t>(std::chrono::steady_clock::now().time_since_epoch().count());
}

/// What came of one topic.
class Arrivals {
 public:
  explicit Arrivals(const char* topic) : topic_(topic) {}

  void note(const Stamp& stamp) {
    // A publisher that was started again begins with 1.
    if (stamp.number > last_ + 1 && last_ != 0) missing_ += stamp.number - last_ - 1;
    last_ = stamp.number;
    ages_ms_.push_back(static_cast<double>(now_ns() - stamp.pushed_ns) / 1e6);
  }
  void print() {
    if (ages_ms_.empty()) {
      std::printf("%-14s nothing came\n", topic_);
      return;
    }
    std::sort(ages_ms_.begin(), ages_ms_.end());
    const auto at = [&](double part) {
      return ages_ms_[static_cast<std::size_t>(part * static_cast<double>(ages_ms_.size() - 1))];
    };
    std::printf("%-14s %6zu came, %5llu missing; ms: median %7.2f, p99 %7.2f, max %7.2f\n", topic_,
                ages_ms_.size(), static_cast<unsigned long long>(missing_), at(0.5), at(0.99),
                at(1));
  }

 private:
  const char* topic_;
  std::uint64_t last_ = 0;
  std::uint64_t missing_ = 0;
  std::vector<double> ages_ms_;
};

template <class T, class Fill>
void push(lot::ShmPusher<T>& pusher, std::uint64_t number, Fill&& fill) {
  auto message = pusher.loan();
  fill(*message);
  message->stamp = {number, now_ns()};
  (void)pusher.push(std::move(message));
}

void cameras(lot::ShmEngine& engine, const lot::StopToken& stop) {
  auto front = engine.advertise<Image>("/camera/front");
  std::uint64_t number = 0;
  lot::WaitSet set;
  set.add_timer(
      33ms, [&] { push(front, ++number, [](Image& image) { image.pixels.resize(kImageBytes); }); });
  set.run(stop);
  std::printf("%-14s %6llu sent\n", "/camera/front", static_cast<unsigned long long>(number));
}

void planner(lot::ShmEngine& engine, const lot::StopToken& stop) {
  auto front = engine.subscribe<Image>("/camera/front");
  auto control = engine.advertise<Control>("/control");
  auto map = engine.advertise<Map>("/map");
  Arrivals images("/camera/front");
  std::uint64_t number = 0;
  push(map, 1, [](Map& m) { m.cells.resize(kMapBytes); });
  lot::WaitSet set;
  set.add(front, [&] {
    while (auto image = front.try_pull()) images.note(image->stamp);
  });
  set.add_timer(2500us, [&] { push(control, ++number, [](Control& c) { c.speed = 1; }); });
  set.run(stop);
  images.print();
  std::printf("%-14s %6llu sent\n", "/control", static_cast<unsigned long long>(number));
}

void operate(lot::ShmEngine& engine, const lot::StopToken& stop) {
  auto control = engine.subscribe<Control>("/control");
  lot::PullerOptions latched;
  latched.history = 1;
  auto map = engine.subscribe<Map>("/map", latched);
  Arrivals controls("/control");
  unsigned maps = 0;
  lot::WaitSet set;
  set.add(control, [&] {
    while (auto c = control.try_pull()) controls.note(c->stamp);
  });
  set.add(map, [&] {
    while (map.try_pull()) ++maps;
  });
  set.run(stop);
  controls.print();
  std::printf("%-14s %6u came\n", "/map", maps);
}

}  // namespace

int main(int argc, char** argv) {
  const std::string role = argc == 2 ? argv[1] : "";
  try {
    const lot::StopToken stop = lot::stop_on_signals();
    lot::ShmEngine engine;
    if (role == "cameras") {
      cameras(engine, stop);
    } else if (role == "planner") {
      planner(engine, stop);
    } else if (role == "operator") {
      operate(engine, stop);
    } else {
      std::fprintf(stderr, "fleet cameras | planner | operator\n");
      return 2;
    }
  } catch (const std::exception& e) {
    std::fprintf(stderr, "fleet: %s\n", e.what());
    return 1;
  }
}
