// SPDX-License-Identifier: Apache-2.0

// Memory between processes: nobody starves, whoever came first, and whoever does nothing more.
// LOT_FRAME_MIB and LOT_PERIOD_MS say what a camera publishes (tests/CMakeLists.txt). Of its frames
// 64 make a segment.

#include <csignal>
#include <cstdint>
#include <deque>
#include <random>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// As the README's camera on the default segment: 64 frames do not fit.
constexpr std::size_t kFrame = std::size_t{LOT_FRAME_MIB} << 20;
constexpr std::size_t kSegment = 64 * kFrame;
constexpr std::size_t kFits = 60;
/// Frames that are 60 % of an equal share of those that fit.
constexpr std::size_t fair(std::size_t cameras, std::size_t fits = kFits) {
  return (fits * 6 + 10 * cameras - 1) / (10 * cameras);
}
constexpr std::chrono::milliseconds kPeriod{LOT_PERIOD_MS};
/// A newcomer has its share when it has published so many: what it publishes in 2 s at 30 Hz.
constexpr std::uint64_t kNewcomer = 60;
/// A share is looked at so many times more, once a frame of the newcomer.
constexpr std::uint64_t kLooks = 20;

struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<unsigned char> data;
};
struct Note {
  lot::ShmString text;
};
/// Small, but it keeps a frame.
struct Detection {
  std::uint64_t number = 0;
  lot::ShmRef<const Frame> frame;
};

std::string topic(std::size_t n) { return "/camera" + std::to_string(n); }

void push(lot::ShmPusher<Frame>& pusher, std::uint64_t number, std::size_t bytes = kFrame) {
  auto frame = pusher.loan();
  frame->number = number;
  frame->data.resize(bytes);
  frame->data.front() = frame->data.back() = static_cast<unsigned char>(number);
  must(pusher.push(std::move(frame)) == lot::Status::Ok, "pushed");
}

/// A process that publishes frames with default options until it is told to end. What it throws
/// ends it with 2.
class Camera {
 public:
  /// `burst`: frames at once, before it says that it is ready. Then one each `period`; none: zero.
  /// It tells of each of those.
  Camera(const lot::EngineOptions& options, std::string name, std::uint64_t burst,
         std::chrono::milliseconds period)
      : child_([&options, &name, burst, period, this] {
          lot::ShmEngine engine(options);
          auto pusher = engine.advertise<Frame>(name);
          std::uint64_t n = 0;
          while (n < burst) push(pusher, n++);
          ready_.tell();
          const auto wait = period == 0ms ? std::chrono::milliseconds(60000) : period;
          while (end_.next(wait) == 0) {
            push(pusher, n++);
            published_.tell();
          }
        }) {}
  bool is_ready() const { return ready_.next() == '.'; }
  /// Waits until it has published so many more, one each period.
  bool has_published(std::uint64_t frames) const {
    while (frames != 0 && published_.next() == '.') --frames;
    return frames == 0;
  }
  void stop() const {
    child_.send(SIGSTOP);
    int status = 0;
    must(waitpid(child_.pid(), &status, WUNTRACED) == child_.pid() && WIFSTOPPED(status),
         "it has stopped");
  }
  void go_on() const { child_.send(SIGCONT); }
  void kill() { child_.kill9(); }
  int end() {
    end_.tell();
    return child_.wait();
  }

 private:
  Steps ready_, published_, end_;
  Child child_;
};

/// A process with default options that publishes a detection of each frame, which refers to it. It
/// tells of each.
class Detector {
 public:
  explicit Detector(const lot::EngineOptions& options)
      : child_([&options, this] {
          lot::ShmEngine engine(options);
          auto frames = engine.subscribe<Frame>(topic(0));
          auto pusher = engine.advertise<Detection>("/detections");
          published_.tell();
          while (end_.next(0ms) == 0) {
            auto frame = frames.pull(10ms);
            if (!frame) continue;
            auto detection = pusher.loan();
            detection->number = frame->number;
            detection->frame = std::move(frame);
            must(pusher.push(std::move(detection)) == lot::Status::Ok, "pushed");
            published_.tell();
          }
        }) {}
  /// The first time: it is ready.
  bool has_published() const { return published_.next() == '.'; }
  void kill() { child_.kill9(); }
  int end() {
    end_.tell();
    return child_.wait();
  }

 private:
  Steps published_, end_;
  Child child_;
};

/// How many frames its ring has, for one that asks for all.
std::size_t held(lot::ShmEngine& engine, const std::string& name) {
  lot::PullerOptions all;
  all.history = 64;
  return engine.subscribe<Frame>(name, all).size();
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("a camera that comes later gets its share from one in another process") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  {
    Camera front(options, topic(0), 200, kPeriod);
    REQUIRE(front.is_ready());
    Camera rear(options, topic(1), 1, kPeriod);
    REQUIRE(rear.is_ready());
    lot::ShmEngine engine(options);
    REQUIRE(rear.has_published(kNewcomer - 1));
    // At least 60 % of an equal share each, and it stays so.
    for (std::uint64_t look = 0; look <= kLooks; ++look) {
      CAPTURE(look);
      CHECK(held(engine, topic(1)) >= fair(2));
      CHECK(held(engine, topic(0)) >= fair(2));
      REQUIRE(rear.has_published(1));
    }
    CHECK(rear.end() == 0);
    CHECK(front.end() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a camera that has memory and does nothing more gives way to one that comes") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Camera idle(options, topic(0), 200, 0ms);
  REQUIRE(idle.is_ready());
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>(topic(1));
    for (std::uint64_t n = 0; n < kNewcomer; ++n) push(pusher, n);
    CHECK(held(engine, topic(1)) >= fair(2));
    CHECK(held(engine, topic(0)) >= fair(2));
  }
  CHECK(idle.end() == 0);
}

TEST_CASE("eight cameras come and go in any order, with readers and without, and none throws") {
  const Watchdog watchdog(60);
  std::mt19937_64 random(seed());
  const auto options = fresh(kSegment);
  constexpr std::size_t kCameras = 8;
  lot::ShmEngine engine(options);
  std::deque<std::optional<Camera>> cameras(kCameras);
  std::vector<std::optional<lot::ShmPuller<Frame>>> readers(kCameras);
  for (int step = 0; step < 40; ++step) {
    const std::size_t n = random() % kCameras;
    if (cameras[n]) {
      CHECK(cameras[n]->end() == 0);
      cameras[n].reset();
    } else {
      cameras[n].emplace(options, topic(n), random() % 100 + 1, kPeriod);
      REQUIRE(cameras[n]->is_ready());
    }
    const std::size_t r = random() % kCameras;
    readers[r] ? readers[r].reset() : (void)readers[r].emplace(engine.subscribe<Frame>(topic(r)));
    for (auto& reader : readers) {
      if (reader) (void)reader->try_pull();
    }
  }
  // The last one always is a newcomer.
  const std::size_t last = random() % kCameras;
  if (cameras[last]) CHECK(cameras[last]->end() == 0);
  cameras[last].reset();
  for (std::size_t n = 0; n < kCameras; ++n) {
    if (!cameras[n] && n != last) cameras[n].emplace(options, topic(n), 1, kPeriod);
  }
  cameras[last].emplace(options, topic(last), 1, kPeriod);
  for (const auto& camera : cameras) REQUIRE(camera->has_published(kNewcomer - 1));
  for (std::uint64_t look = 0; look <= kLooks; ++look) {
    CAPTURE(look);
    for (std::size_t n = 0; n < kCameras; ++n) {
      CAPTURE(n);
      // On two cores a camera may be held up with a frame in hand, which is in no queue: then it
      // has its share again within two seconds.
      CHECK(eventually([&] { return held(engine, topic(n)) >= fair(kCameras); }, 2s));
    }
    REQUIRE(cameras[last]->has_published(1));
  }
  for (std::size_t n = 0; n < kCameras; ++n) {
    CAPTURE(n);
    if (!readers[n]) readers[n].emplace(engine.subscribe<Frame>(topic(n)));
    CHECK(readers[n]->pull(10s) != nullptr);
  }
  for (auto& camera : cameras) CHECK(camera->end() == 0);
}

TEST_CASE("messages that a reader keeps do not keep their camera from giving way") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Camera front(options, topic(0), 200, 0ms);
  REQUIRE(front.is_ready());
  {
    lot::ShmEngine engine(options);
    lot::PullerOptions all;
    all.history = 64;
    all.max_held_bytes = lot::PullerOptions::kNoQuota;
    auto reader = engine.subscribe<Frame>(topic(0), all);
    std::vector<lot::ShmSharedPtr<const Frame>> kept;
    while (kept.size() < 15) kept.push_back(reader.pull(10s));
    auto pusher = engine.advertise<Frame>(topic(1));
    for (std::uint64_t n = 0; n < kNewcomer; ++n) push(pusher, n);
    CHECK(held(engine, topic(1)) >= fair(2, kFits - 15));
    // The ring has them still.
    auto late = engine.subscribe<Frame>(topic(0), all);
    for (const auto& frame : kept) {
      const auto again = late.try_pull();
      REQUIRE(again);
      CHECK(again->number == frame->number);
    }
  }
  CHECK(front.end() == 0);
}

TEST_CASE("messages of a killed camera give way, before those of living ones") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  auto late = engine.subscribe<Frame>(topic(0));
  {
    Camera killed(options, topic(0), 200, 0ms);
    REQUIRE(killed.is_ready());
    killed.kill();
  }
  lot::segment::Segment segment(engine.path());
  CHECK(eventually([&] { return Audit(segment).participants == 1; }));  // it is known to be dead
  auto pusher = engine.advertise<Frame>(topic(1));
  // More than fit, wherever the others lie.
  for (std::uint64_t n = 0; n < 70; ++n) push(pusher, n);
  CHECK(held(engine, topic(1)) >= kFits * 8 / 10);
  // The newest two are there, and what is not counts as missed.
  std::uint64_t got = 0;
  while (const auto frame = late.pull(10s)) {
    ++got;
    CHECK(frame->number >= 198);
  }
  CHECK(got == 2);
  CHECK(late.missed_total() == 198);
}

TEST_CASE("messages of a closed camera do not go in vain while its process is stopped") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  auto late = engine.subscribe<Frame>(topic(0));
  Steps ready, end;
  Child other([&] {
    lot::ShmEngine mine(options);
    {
      auto pusher = mine.advertise<Frame>(topic(0));
      for (std::uint64_t n = 0; n < 20; ++n) push(pusher, n);
    }
    ready.tell();
    end.next(60s);
  });
  REQUIRE(ready.next() == '.');
  other.send(SIGSTOP);
  int status = 0;
  REQUIRE(waitpid(other.pid(), &status, WUNTRACED) == other.pid());
  auto pusher = engine.advertise<Frame>(topic(1));
  for (std::uint64_t n = 0; n < 100; ++n) push(pusher, n);
  std::uint64_t got = 0;
  while (late.try_pull()) ++got;
  CHECK(got >= 19);  // with the first of them it showed
  other.send(SIGCONT);
  end.tell();
  CHECK(other.wait() == 0);
}

TEST_CASE("a small topic has room beside big ones of other processes") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Camera front(options, topic(0), 200, kPeriod);
  Camera rear(options, topic(1), 200, kPeriod);
  REQUIRE(front.is_ready());
  REQUIRE(rear.is_ready());
  {
    lot::ShmEngine engine(options);
    auto notes = engine.advertise<Note>("/notes");
    for (int n = 0; n < 500; ++n) {
      auto note = notes.loan();
      note->text.assign(10000, 'x');
      REQUIRE(notes.push(std::move(note)) == lot::Status::Ok);
    }
    lot::PullerOptions all;
    all.history = 64;
    CHECK(engine.subscribe<Note>("/notes", all).size() == 64);
  }
  CHECK(front.end() == 0);
  CHECK(rear.end() == 0);
}

TEST_CASE("blocks that the messages of another process have are given up, too") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.blocks = 64;
  Steps ready, end;
  Child other([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Note>("/notes");
    for (int n = 0; n < 100; ++n) must_go(pusher.push(pusher.loan()));
    ready.tell();
    end.next();
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Note>("/others");
    std::vector<lot::ShmUniquePtr<Note>> loans;
    for (int n = 0; n < 60; ++n) loans.push_back(pusher.loan());
    CHECK_THROWS_AS((loans.push_back(pusher.loan()), loans.push_back(pusher.loan()),
                     loans.push_back(pusher.loan())),
                    lot::OutOfMemory);  // the newest two stay
  }
  end.tell();
  CHECK(other.wait() == 0);
}

TEST_CASE("OutOfMemory says what would have fitted, which process holds most, and what helps") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.name = "the camera";
  Steps ready, end;
  Child keeper([&] {
    auto mine = options;
    mine.name = "the keeper";
    lot::ShmEngine engine(mine);
    lot::PullerOptions greedy;
    greedy.max_held_bytes = lot::PullerOptions::kNoQuota;
    auto reader = engine.subscribe<Frame>(topic(0), greedy);
    ready.tell();
    std::vector<lot::ShmSharedPtr<const Frame>> kept;
    while (kept.size() < 40) kept.push_back(reader.pull(20s));
    ready.tell();
    end.next();
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>(topic(0), {lot::Policy::Block, 4, 20s});
    for (std::uint64_t n = 0; n < 40; ++n) push(pusher, n);
    REQUIRE(ready.next() == '.');
    auto frame = pusher.loan();
    std::string text;
    try {
      frame->data.resize(kSegment / 2);
    } catch (const lot::OutOfMemory& e) {
      text = e.what();
    }
    CAPTURE(text);
    for (const char* part :
         {"the largest free piece has ", " MiB are of /camera0", "the camera (pid ",
          "the keeper (pid ", "keeps ", "let that one keep fewer", "LOT_SIZE"}) {
      CHECK(text.find(part) != std::string::npos);
    }
    const std::string kept = std::to_string(40 * LOT_FRAME_MIB) + " MiB";
    CHECK(text.find("keeps " + kept) != std::string::npos);
  }
  end.tell();
  CHECK(keeper.wait() == 0);
}

TEST_CASE("a stopped camera cannot give way, other ones do, and it does when it goes on") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Camera stopped(options, topic(0), 200, 0ms);
  REQUIRE(stopped.is_ready());
  Camera other(options, topic(1), 60, 0ms);
  REQUIRE(other.is_ready());
  lot::ShmEngine engine(options);
  stopped.stop();
  const std::size_t before = held(engine, topic(0));
  auto pusher = engine.advertise<Frame>(topic(2));
  for (std::uint64_t n = 0; n < 60; ++n) push(pusher, n);
  CHECK(held(engine, topic(0)) == before);
  CHECK(held(engine, topic(2)) >= held(engine, topic(1)) - 1);
  stopped.go_on();
  CHECK(eventually([&] {
    push(pusher, 0);
    return held(engine, topic(0)) < before && held(engine, topic(2)) >= kFits * 2 / 10;
  }));
  CHECK(stopped.end() == 0);
  CHECK(other.end() == 0);
}

TEST_CASE("frames that messages of another process refer to give way, but for its newest two") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Detector detector(options);
  REQUIRE(detector.has_published());
  {
    lot::ShmEngine engine(options);
    auto camera = engine.advertise<Frame>(topic(0));
    auto viewer = engine.subscribe<Frame>(topic(0));
    lot::ShmSharedPtr<const Frame>
        kept;  // its detection frees nothing, and does not hold others up
    bool keeps = false;
    SUBCASE("and no reader keeps one") {}
    SUBCASE("also behind one that a reader keeps") { keeps = true; }
    for (std::uint64_t n = 0; n < 3 * kFits; ++n) {
      push(camera, n);
      REQUIRE(detector.has_published());
      if (keeps && n == 3) kept = viewer.try_pull();
    }
    CHECK(static_cast<bool>(kept) == keeps);
    lot::PullerOptions newest;
    newest.history = 2;
    auto detections = engine.subscribe<Detection>("/detections", newest);
    for (std::uint64_t n = 3 * kFits - 2; n < 3 * kFits; ++n) {
      const auto detection = detections.try_borrow();
      REQUIRE(detection);
      CHECK(detection->number == n);
      REQUIRE(detection->frame);
      CHECK(detection->frame->number == n);
      CHECK(detection->frame->data.back() == static_cast<unsigned char>(n));
    }
  }
  CHECK(detector.end() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("frames that messages of another process refer to give way when the camera has gone") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  Detector detector(options);
  REQUIRE(detector.has_published());
  {
    Camera camera(options, topic(0), 1, 1ms);
    REQUIRE(camera.is_ready());
    for (std::uint64_t n = 0; n < 2 * kFits; ++n) REQUIRE(detector.has_published());
    SUBCASE("killed") { camera.kill(); }
    SUBCASE("ended") { CHECK(camera.end() == 0); }
  }
  {
    lot::ShmEngine engine(options);
    auto late = engine.advertise<Frame>(topic(1));
    push(late, 0);
    lot::PullerOptions all;
    all.history = 64;  // one frame costs few detections
    CHECK(engine.subscribe<Detection>("/detections", all).size() >= kFits / 2);
    for (std::uint64_t n = 1; n < 2 * kFits; ++n) push(late, n);
    CHECK(held(engine, topic(1)) >= fair(2));
  }
  CHECK(detector.end() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("frames that messages of a killed process refer to give way") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  lot::ShmEngine engine(options);
  auto reader = engine.subscribe<Detection>("/detections");  // for it the killed one's queue stays
  auto camera = engine.advertise<Frame>(topic(0));
  {
    Detector detector(options);
    REQUIRE(detector.has_published());
    for (std::uint64_t n = 0; n < 40; ++n) {
      push(camera, n);
      REQUIRE(detector.has_published());
    }
    detector.kill();
  }
  for (std::uint64_t n = 0; n < 3 * kFits; ++n) push(camera, n);
  CHECK(held(engine, topic(0)) >= kFits * 8 / 10);
}

TEST_CASE("what reserve() made stays in the queue of another process that has published it again") {
  const Watchdog watchdog(60);
  const auto options = fresh(kSegment);
  constexpr std::uint64_t kReserved = 8;
  Steps ready, go, end;
  Child owner([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>(topic(0));
    pusher.reserve(kReserved, kFrame);
    ready.tell();
    must(go.next() != 0, "the relay is there");
    for (std::uint64_t n = 0; n < kReserved; ++n) push(pusher, n);
    ready.tell();
    must(go.next() != 0, "all other memory is taken");
    for (std::uint64_t n = kReserved; n < 3 * kReserved; ++n) push(pusher, n);
    ready.tell();
    end.next();
  });
  REQUIRE(ready.next() == '.');
  Child relay([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Frame>(topic(0));
    auto pusher = engine.advertise<Frame>(topic(1));
    ready.tell();
    for (std::uint64_t n = 0; n < kReserved; ++n) {
      must(pusher.push(puller.pull(20s)) == lot::Status::Ok, "published again");
    }
    ready.tell();
    end.next();
  });
  REQUIRE(ready.next() == '.');
  go.tell();
  for (int n = 0; n < 2; ++n) REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto greedy = engine.advertise<Frame>("/greedy");
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    const auto take_all = [&] {
      for (;;) {
        auto loan = greedy.loan();
        loan->data.resize(kFrame / 4);
        loans.push_back(std::move(loan));
      }
    };
    CHECK_THROWS_AS(take_all(), lot::OutOfMemory);
    lot::PullerOptions all;
    all.history = 64;
    for (const auto& name : {topic(0), topic(1)}) {
      CAPTURE(name);
      auto reader = engine.subscribe<Frame>(name, all);
      for (std::uint64_t n = 0; n < kReserved; ++n) {
        const auto frame = reader.try_borrow();
        REQUIRE(frame);
        CHECK(frame->number == n);
        CHECK(frame->data.back() == static_cast<unsigned char>(n));
      }
    }
    // Its publisher has that memory again when the relay has gone.
    end.tell();
    REQUIRE(relay.wait() == 0);
    go.tell();
    CHECK(ready.next() == '.');
  }
  end.tell();
  CHECK(owner.wait() == 0);
}

TEST_SUITE_END();
