// SPDX-License-Identifier: Apache-2.0

// Several engines in one process: on several segments, and by several copies of the library.

#include <array>
#include <atomic>
#include <cstdint>
#include <dlfcn.h>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "plugin.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using Shared = lot::ShmSharedPtr<const Frame>;

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// A plugin that was loaded, with its object.
class Loaded {
 public:
  Loaded(const char* path, int scope) : path_(path), object_(dlopen(path, RTLD_NOW | scope)) {
    if (object_ == nullptr) throw std::runtime_error(dlerror());
    const auto make = reinterpret_cast<MakePlugin>(dlsym(object_, "make_plugin"));
    if (make == nullptr) throw std::runtime_error(dlerror());
    plugin_.reset(make());
  }
  ~Loaded() { unload(); }
  Loaded(const Loaded&) = delete;
  Loaded& operator=(const Loaded&) = delete;

  Plugin* operator->() const { return plugin_.get(); }
  Plugin& operator*() const { return *plugin_; }
  /// As a plugin manager does it.
  void unload() {
    plugin_.reset();
    if (object_ != nullptr) dlclose(std::exchange(object_, nullptr));
  }
  bool is_there() const {
    void* object = dlopen(path_, RTLD_NOW | RTLD_NOLOAD);
    if (object != nullptr) dlclose(object);
    return object != nullptr;
  }

 private:
  const char* path_;
  void* object_;
  std::unique_ptr<Plugin> plugin_;
};

std::size_t participants(const lot::ShmEngine& engine) {
  lot::segment::Segment s(engine.path());
  return Audit(s).participants;
}

#define LOT_MUST(what) must(static_cast<bool>(what), #what)

/// Whether a pointer that holds a frame, but points to another one, is not pushed.
bool refuses_part(Plugin& plugin, const Shared& frame) {
  static const Frame mine{};
  try {
    plugin.push(Shared(frame, &mine));
  } catch (const std::runtime_error&) {
    return true;
  }
  return false;
}

/// Everything that two copies of the library do with each other's messages.
void exchange(Plugin& one, Plugin& two) {
  for (std::uint64_t n = 0; n < 50; ++n) {
    {  // Pointers, in both directions, released by either.
      Shared made = one.make(n);
      LOT_MUST(good(*made, n));
      two.keep(made);
      const lot::ShmWeakPtr<const Frame> weak = two.watch();
      LOT_MUST(made.use_count() == 2);
      made.reset();
      LOT_MUST(good(*weak.lock(), n));
      Shared last = two.keep(two.make(n + 1000));
      LOT_MUST(weak.lock() == last);
      last.reset();
      LOT_MUST(weak.expired());
      one.keep(two.keep(nullptr));
      LOT_MUST(good(*one.keep(nullptr), n + 1000));
    }
    {  // Each publishes what the other has made, shared and unique, and the other pulls it again.
      LOT_MUST(two.push(one.make(n)) == lot::Status::Ok);
      const Shared first = two.pull();
      LOT_MUST(first);
      LOT_MUST(good(*first, n));
      LOT_MUST(one.push(first) == lot::Status::Ok);
      const Shared again = one.pull();
      LOT_MUST(again);
      LOT_MUST(good(*again, n));
      LOT_MUST(again != first);  // another mapping
      LOT_MUST(refuses_part(two, first));
      LOT_MUST(refuses_part(two, one.make(n)));
      LOT_MUST(two.push(one.loan(n + 1)) == lot::Status::Ok);
      LOT_MUST(one.push(two.loan(n + 2)) == lot::Status::Ok);
      LOT_MUST(good(*two.pull(), n + 1));
      LOT_MUST(good(*one.pull(), n + 2));
    }
  }
}

/// What is loaded stays: each test of plugins is a process of its own.
template <class F>
void in_a_process(F&& f) {
  const Watchdog watchdog(100);
  const auto options = fresh(256 << 20);
  CHECK(Child([&] { f(options); }).wait() == 0);
  CHECK(files_of(options) == 0);
  for (const char* suffix : {"", ".lock"}) {  // of one that has crashed
    std::filesystem::remove(options.directory + "/" + options.segment + suffix);
  }
}

void messages_and_pointers(const lot::EngineOptions& options, int scope) {
  lot::ShmEngine engine(options);
  Loaded one(LOT_PLUGIN_ONE, scope);
  Loaded two(LOT_PLUGIN_TWO, scope);
  one->join(options, "one");
  two->join(options, "two");
  LOT_MUST(participants(engine) == 3);
  exchange(*one, *two);
  // A reference needs the address of the target in the copy's own mapping.
  two->keep(one->make(7));
  bool refused = false;
  try {
    two->refer();
  } catch (const std::exception&) {
    refused = true;
  }
  LOT_MUST(refused);
  two->keep(two->make(8));
  LOT_MUST(two->refer() == 8);
  // The host has a copy too.
  auto pusher = engine.advertise<Frame>("/one");
  LOT_MUST(pusher.push(two->make(9)) == lot::Status::Ok);
  LOT_MUST(good(*one->pull(), 9));
}

/// Several threads push on one pusher: unique and shared messages of their own copy and of another.
void push_from_threads(const lot::EngineOptions& options) {
  constexpr std::uint64_t kThreads = 4;
  constexpr std::uint64_t kMessages = 100;
  lot::ShmEngine engine(options);
  Loaded one(LOT_PLUGIN_ONE, RTLD_LOCAL);
  one->join(options, "one");
  auto pusher = engine.advertise<Frame>("/t", {lot::Policy::Block, 4, 50s});
  auto puller = engine.subscribe<Frame>("/t");
  std::vector<std::thread> threads;
  std::atomic<std::uint64_t> pushed{0};
  for (std::uint64_t t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      for (std::uint64_t n = 0; n < kMessages; ++n) {
        const std::uint64_t number = 1000 * t + n;
        auto frame = n % 2 == 0 ? pusher.loan() : one->loan(number);
        if (n % 2 == 0) fill(*frame, number);
        const auto status =
            n % 4 < 2 ? pusher.push(std::move(frame)) : pusher.push(Shared(std::move(frame)));
        pushed += status == lot::Status::Ok;
      }
    });
  }
  std::array<std::uint64_t, kThreads> next{};
  for (std::uint64_t n = 0; n < kThreads * kMessages; ++n) {
    const auto seen = puller.pull(50s);
    LOT_MUST(seen);
    const std::uint64_t thread = seen->number / 1000;
    LOT_MUST(thread < kThreads && good(*seen, 1000 * thread + next[thread]++));
  }
  for (auto& thread : threads) thread.join();
  LOT_MUST(pushed == kThreads * kMessages);
}

void unload_what_is_in_use(const lot::EngineOptions& options) {
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/two");
  Shared kept;
  lot::ShmWeakPtr<const Frame> weak;
  lot::ShmUniquePtr<Frame> loaned;
  {
    Loaded one(LOT_PLUGIN_ONE, RTLD_LOCAL);
    Loaded two(LOT_PLUGIN_TWO, RTLD_LOCAL);
    one->join(options, "one");
    two->join(options, "two");
    kept = one->make(1);
    two->keep(one->make(2));
    weak = two->watch();
    loaned = one->loan(3);
    LOT_MUST(one->push(one->make(4)) == lot::Status::Ok);
    LOT_MUST(two->push(one->make(5)) == lot::Status::Ok);
    one.unload();
    LOT_MUST(one.is_there());
    LOT_MUST(participants(engine) == 3);  // its pointers live
    LOT_MUST(good(*kept, 1));
    LOT_MUST(good(*weak.lock(), 2));
    LOT_MUST(good(*loaned, 3));
    LOT_MUST(good(*two->pull(), 5));
    // Its warden runs: nobody takes it for dead, and nothing of it is freed.
    std::this_thread::sleep_for(300ms);
    LOT_MUST(participants(engine) == 3);
    LOT_MUST(two->push(kept) == lot::Status::Ok);
    LOT_MUST(good(*two->pull(), 1));
    LOT_MUST(pusher.push(std::move(loaned)) == lot::Status::Ok);
    LOT_MUST(good(*two->pull(), 3));
    two->keep(nullptr);
    LOT_MUST(weak.expired());
    // Loaded again, it is the same object, and its copy of the library is still a participant.
    Loaded again(LOT_PLUGIN_ONE, RTLD_LOCAL);
    again->join(options, "one");
    two->keep(again->make(6));
    LOT_MUST(good(*two->keep(nullptr), 6));
  }
  // Of all of them only the first one's pointer is left.
  LOT_MUST(eventually([&] { return participants(engine) == 2; }));
  LOT_MUST(good(*kept, 1));
  kept.reset();
  weak.reset();
  LOT_MUST(eventually([&] { return participants(engine) == 1; }));
}

void unload_what_nobody_uses(const lot::EngineOptions& options) {
  for (std::uint64_t n = 0; n < 10; ++n) {
    Loaded one(LOT_PLUGIN_ONE, RTLD_LOCAL);
    one->join(options, "one");
    LOT_MUST(one->push(one->make(n)) == lot::Status::Ok);
    LOT_MUST(good(*one->pull(), n));
    one.unload();
    LOT_MUST(files_of(options) == 0);  // it has left, and was the last
  }
}

void outlive_the_engine(const lot::EngineOptions& options) {
  Loaded one(LOT_PLUGIN_ONE, RTLD_LOCAL);
  Loaded two(LOT_PLUGIN_TWO, RTLD_LOCAL);
  one->join(options, "one");
  two->join(options, "two");
  two->keep(one->make(1));
  LOT_MUST(one->push(one->make(2)) == lot::Status::Ok);
  Shared pulled = one->pull();
  one->leave();
  lot::segment::Segment segment(options.directory + "/" + options.segment);
  LOT_MUST(Audit(segment).participants == 2);
  LOT_MUST(good(*pulled, 2));
  LOT_MUST(two->push(pulled) == lot::Status::Ok);
  LOT_MUST(good(*two->pull(), 2));
  LOT_MUST(good(*two->keep(nullptr), 1));
  pulled.reset();
  LOT_MUST(eventually([&] { return Audit(segment).participants == 1; }));
  one->join(options, "one");
  exchange(*one, *two);
}

}  // namespace

TEST_SUITE_BEGIN("copies");

TEST_CASE("engines on several segments of one process have nothing to do with each other") {
  const Watchdog watchdog(60);
  constexpr std::size_t kSegments = 8;
  std::vector<lot::EngineOptions> options;
  for (std::size_t i = 0; i < kSegments; ++i) options.push_back(fresh(16 << 20));
  {
    std::vector<lot::ShmEngine> engines;
    std::vector<lot::ShmPusher<Frame>> pushers;
    std::vector<lot::ShmPuller<Frame>> pullers;
    for (const auto& o : options) {
      engines.emplace_back(o);
      pushers.push_back(engines.back().advertise<Frame>("/t"));
      pullers.push_back(engines.back().subscribe<Frame>("/t"));
    }
    std::vector<std::thread> threads;
    for (std::size_t i = 0; i < kSegments; ++i) {
      threads.emplace_back([&, i] {
        for (std::uint64_t n = 0; n < 100; ++n) {
          auto frame = pushers[i].loan();
          fill(*frame, 1000 * i + n);
          must_go(pushers[i].push(std::move(frame)));
          const auto seen = pullers[i].try_pull();
          if (!seen || !good(*seen, 1000 * i + n) || pullers[i].missed_total() != 0) return;
        }
        must_go(pushers[i].push(pushers[i].loan()));  // the sign that all went well
      });
    }
    for (auto& thread : threads) thread.join();
    for (std::size_t i = 0; i < kSegments; ++i) {
      CHECK(pullers[i].try_pull());
      CHECK(!pullers[i].try_pull());
      CHECK(participants(engines[i]) == 1);
    }
    // What one segment has another cannot publish, nor refer to.
    const Shared frame = pushers[0].loan();
    CHECK_THROWS_AS((void)pushers[1].push(frame), lot::Error);
    auto link = engines[1].make<Link>();
    CHECK_THROWS_AS(link->frame = frame, lot::Error);
    engines.erase(engines.begin());
    CHECK(pushers[0].push(frame) == lot::Status::Ok);
  }
  for (const auto& o : options) CHECK(files_of(o) == 0);
}

TEST_CASE("shared objects with copies of their own exchange pointers and messages") {
  in_a_process([](const auto& options) { messages_and_pointers(options, RTLD_LOCAL); });
}

TEST_CASE("shared objects do so, too, when the names of one are visible to the other") {
  in_a_process([](const auto& options) { messages_and_pointers(options, RTLD_GLOBAL); });
}

TEST_CASE("threads push on one pusher what their copy and another have made") {
  in_a_process([](const auto& options) { push_from_threads(options); });
}

TEST_CASE("a shared object that is unloaded while it is used stays, and so do its messages") {
  in_a_process([](const auto& options) { unload_what_is_in_use(options); });
}

TEST_CASE("a shared object that is unloaded when it is not used has left, and can come again") {
  in_a_process([](const auto& options) { unload_what_nobody_uses(options); });
}

TEST_CASE("pointers outlive the engine, pusher and puller of the copy that made them") {
  in_a_process([](const auto& options) { outlive_the_engine(options); });
}

TEST_SUITE_END();
