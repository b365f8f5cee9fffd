// SPDX-License-Identifier: Apache-2.0

// Strings, vectors and references in messages.

#if defined(__GNUC__) && !defined(__clang__)
// g++ 12 does not see, through a pointer that is a class, that libstdc++'s string assignment only
// uses the old capacity together with the old data.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <pthread.h>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

/// A message whose constructor fails after it has taken memory.
struct Failing {
  lot::ShmVector<std::uint8_t> data;
  explicit Failing(bool fails) {
    data.resize(1 << 20);
    if (fails) throw std::runtime_error("no picture");
  }
};
template <>
struct lot::is_trusted_message<Failing> : std::true_type {};

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

const char* const kLong = "a text that is much too long for the small string in place";

struct Field {
  lot::ShmString name;
  std::uint32_t offset = 17;
  std::uint32_t count;
};
struct Cloud {
  std::uint32_t width = 3;
  lot::ShmString frame_id;
  lot::ShmVector<Field> fields;
  lot::ShmVector<lot::ShmVector<float>> rows;
  lot::ShmVector<std::uint8_t> data;
  std::array<lot::ShmString, 2> notes;
};
struct Names {
  lot::ShmVector<lot::ShmString> names;
};
struct Target {
  std::uint64_t number;
  lot::ShmVector<std::uint64_t> data;
};
struct Detection {
  lot::ShmRef<const Target> frame;
  float box[4];
};
struct Detections {
  lot::ShmVector<Detection> all;
  lot::ShmVector<lot::ShmRef<const Target>> refs;
};

struct Tree {
  std::uint32_t number;
  lot::ShmVector<Tree> children;
};
/// An aggregate that declares a destructor.
struct Counting {
  lot::ShmString text;
  ~Counting() { ++destroyed; }
  static inline int destroyed = 0;
};
/// Its fields need no destructor: it has one.
struct Farewell {
  int number;
  ~Farewell() { ++destroyed; }
  static inline int destroyed = 0;
};
struct HoldsCounting {
  lot::ShmVector<Counting> members;
};

struct Place {
  explicit Place(std::uint64_t size = 64 << 20) : options(fresh(size)), engine(options) {
    lot::segment::Segment s(engine.path());
    bytes = s.size();
  }
  lot::EngineOptions options;
  lot::ShmEngine engine;
  std::uint64_t bytes = 0;
};

/// Fills a cloud with what `n` says.
void fill(Cloud& cloud, std::uint32_t n) {
  cloud.width = n;
  cloud.frame_id = kLong;
  cloud.frame_id += std::to_string(n).c_str();
  cloud.fields.resize(4);
  for (std::uint32_t i = 0; i < 4; ++i) {
    cloud.fields[i].name = kLong;
    cloud.fields[i].name += static_cast<char>('a' + i);
    cloud.fields[i].count = i;
  }
  cloud.rows.resize(3);
  for (auto& row : cloud.rows) row.assign(1000, static_cast<float>(n));
  cloud.data.resize(100000);
  std::fill(cloud.data.begin(), cloud.data.end(), static_cast<std::uint8_t>(n));
  cloud.notes[1] = kLong;
}
bool good(const Cloud& cloud, std::uint32_t n) {
  bool ok = cloud.width == n && cloud.fields.size() == 4 && cloud.rows.size() == 3 &&
            cloud.data.size() == 100000 && cloud.notes[0].empty() && cloud.notes[1] == kLong &&
            cloud.frame_id == (kLong + std::to_string(n)).c_str();
  for (std::uint32_t i = 0; ok && i < 4; ++i) {
    ok = cloud.fields[i].name.back() == static_cast<char>('a' + i) && cloud.fields[i].count == i &&
         cloud.fields[i].offset == 17;
  }
  for (const auto& row : cloud.rows) {
    ok = ok && row.size() == 1000 && row[999] == static_cast<float>(n);
  }
  return ok && std::all_of(cloud.data.begin(), cloud.data.end(),
                           [&](auto b) { return b == static_cast<std::uint8_t>(n); });
}

}  // namespace

TEST_SUITE_BEGIN("message");

TEST_CASE("ShmString, ShmVector and nested ones cross to another process") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Cloud>("/t");
    ready.tell();
    for (std::uint32_t n = 0; n < 100; ++n) {
      auto seen = puller.pull(20s);
      must(bool(seen) && good(*seen, n), "the cloud");
      const Cloud mine = *seen;  // a private copy
      seen.reset();
      must(good(mine, n), "the copy");
    }
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Cloud>("/t", {lot::Policy::Block, 3, 30s});
    REQUIRE(pusher.wait_for_readers(1, 10s));
    for (std::uint32_t n = 0; n < 100; ++n) {
      auto cloud = pusher.loan();
      CHECK(cloud->width == 3);  // defaults hold
      CHECK(cloud->fields.empty());
      fill(*cloud, n);
      CHECK(good(*cloud, n));
      REQUIRE(pusher.push(std::move(cloud)) == lot::Status::Ok);
    }
    CHECK(reader.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("everything that is put into a message lies in the segment, wherever it came from") {
  const Watchdog watchdog(60);
  Place place;
  auto pusher = place.engine.advertise<Names>("/names");
  auto clouds = place.engine.advertise<Cloud>("/clouds");
  const auto inside = [](const auto& container) {
    return container.get_allocator().arena() != nullptr;
  };
  auto names = pusher.loan();
  const lot::ShmString heap = kLong;
  CHECK(!inside(heap));
  CHECK(inside(names->names));
  names->names.push_back(heap);
  names->names.push_back(kLong);                  // a temporary on the heap, moved
  names->names.push_back(lot::ShmString(kLong));  // the same
  names->names.emplace_back(kLong);
  names->names.emplace_back();
  names->names.insert(names->names.begin(), lot::ShmString(kLong));
  names->names.resize(10, heap);
  names->names.resize(20);
  for (int i = 0; i < 100; ++i) names->names.emplace_back(kLong);  // they move as it grows
  for (const auto& name : names->names) CHECK(inside(name));
  lot::ShmVector<lot::ShmString> many(5, heap);
  CHECK(!inside(many));
  names->names = many;
  for (const auto& name : names->names) CHECK(inside(name));
  names->names = std::move(many);
  CHECK(inside(names->names));
  for (const auto& name : names->names) CHECK(inside(name));
  names->names[0] = lot::ShmString(kLong);
  names->names[1] = std::move(names->names[2]);
  CHECK(inside(names->names[0]));
  CHECK(inside(names->names[1]));
  CHECK(names->names[1] == kLong);

  auto cloud = clouds.loan();
  Cloud mine;
  fill(mine, 5);
  *cloud = mine;
  CHECK(good(*cloud, 5));
  CHECK(inside(cloud->frame_id));
  CHECK(inside(cloud->fields[0].name));
  cloud->fields.push_back(mine.fields[0]);
  cloud->fields.push_back(Field{lot::ShmString(kLong), 1, 2});
  CHECK(inside(cloud->fields[4].name));
  CHECK(inside(cloud->fields[5].name));
  cloud->rows.push_back(lot::ShmVector<float>(100, 1.0F));
  CHECK(inside(cloud->rows.back()));
  *cloud = std::move(mine);
  CHECK(good(*cloud, 5));
  CHECK(inside(cloud->rows[0]));

  // What loan() is given is copied into the message.
  auto by_copy = pusher.loan(names->names);
  CHECK(inside(by_copy->names));
  CHECK(inside(by_copy->names[0]));
  auto by_move = pusher.loan(lot::ShmVector<lot::ShmString>(3, heap));
  CHECK(inside(by_move->names));
  CHECK(inside(by_move->names[0]));
  auto whole = clouds.loan(*cloud);
  CHECK(good(*whole, 5));
  CHECK(inside(whole->frame_id));
  Cloud another;
  fill(another, 6);
  auto moved = clouds.loan(std::move(another));
  CHECK(good(*moved, 6));
  CHECK(inside(moved->frame_id));
  CHECK(inside(moved->fields[0].name));
}

TEST_CASE("copies are private, and moves between messages copy") {
  Place place;
  auto pusher = place.engine.advertise<Cloud>("/t");
  auto first = pusher.loan();
  fill(*first, 1);
  auto second = pusher.loan();
  *second = std::move(*first);
  CHECK(good(*second, 1));
  const Cloud copy = *second;
  CHECK(copy.data.get_allocator().arena() == nullptr);
  CHECK(copy.fields[0].name.get_allocator().arena() == nullptr);
  second->data[0] = 99;
  second->frame_id = "other";
  CHECK(good(copy, 1));
  first.reset();
  second.reset();
  CHECK(good(copy, 1));
}

TEST_CASE("an exception while a message is built frees it") {
  Place place(16 << 20);
  auto pusher = place.engine.advertise<Target>("/t", {lot::Policy::Overwrite, 2, 1s});
  for (int n = 0; n < 50; ++n) {
    auto target = pusher.loan();
    CHECK_THROWS_AS(target->data.resize(100 << 20), lot::OutOfMemory);
    // Of 2^32 granules the lower 32 bits are 0.
    CHECK_THROWS_AS(target->data.resize(std::size_t{1} << 41), lot::OutOfMemory);
    target->data.resize(1000);
    target->data.assign(1000, 5);
    CHECK(target->data[999] == 5);
  }
  const lot::ShmVector<std::uint64_t> huge(4 << 20);  // 32 MiB
  for (int n = 0; n < 50; ++n) {
    CHECK_THROWS_AS((void)pusher.loan(std::uint64_t{1}, huge), lot::OutOfMemory);
  }
  lot::segment::Segment s(place.engine.path());
  CHECK(Audit(s).homes < 5);
  auto target = pusher.loan();
  target->data.assign(100000, 1);
  CHECK(pusher.push(std::move(target)) == lot::Status::Ok);
}

TEST_CASE("a ShmRef keeps its target alive, and lets it go when its own message dies") {
  const Watchdog watchdog(60);
  Place place;
  lot::segment::Segment s(place.engine.path());
  auto pusher = place.engine.advertise<Detection>("/d", {lot::Policy::Overwrite, 1, 1s});
  auto puller = place.engine.subscribe<Detection>("/d");
  lot::ShmWeakPtr<const Target> watch;
  {
    auto target = place.engine.make<Target>();
    target->number = 7;
    target->data.assign(10000, 7);
    const lot::ShmSharedPtr<const Target> shared = std::move(target);
    watch = shared;
    auto detection = pusher.loan();
    CHECK(!detection->frame);
    detection->frame = shared;
    detection->frame = shared;  // once more changes nothing
    CHECK(detection->frame->number == 7);
    CHECK(detection->frame.get() == shared.get());
    CHECK(shared.use_count() == 1);
    must_go(pusher.push(std::move(detection)));
  }
  CHECK(!watch.expired());
  auto seen = puller.pull(1s);
  REQUIRE(seen);
  CHECK((*seen->frame).data[9999] == 7);
  auto locked = seen->frame.lock();
  CHECK(locked->number == 7);
  locked.reset();
  auto copy = *seen;  // outside of messages it is a share of its own
  seen.reset();
  must_go(pusher.push(pusher.loan()));
  CHECK(copy.frame->number == 7);
  auto again = copy;
  copy = Detection();
  CHECK(again.frame->data[0] == 7);
  CHECK(again.frame.lock()->number == 7);
  again.frame = lot::ShmSharedPtr<const Target>();
  CHECK(!again.frame);
  for (int n = 0; n < 100; ++n) must_go(pusher.push(pusher.loan()));
  CHECK(watch.expired());
}

TEST_CASE("a message of strings and vectors is freed as a whole; any other destructor runs once") {
  using lot::detail::dies_quietly;
  static_assert(dies_quietly<Target>() && dies_quietly<Cloud>() && dies_quietly<Names>());
  static_assert(dies_quietly<std::array<lot::ShmString, 2>>() && dies_quietly<Tree>());
  static_assert(!dies_quietly<Failing>() && !dies_quietly<Detections>());
  static_assert(!dies_quietly<Counting>() && !dies_quietly<HoldsCounting>());
  static_assert(!dies_quietly<Farewell>() && !dies_quietly<std::array<Farewell, 2>>());
  Place place;
  auto pusher = place.engine.advertise<HoldsCounting>("/t", {lot::Policy::Overwrite, 1, 1s});
  place.engine.make<Farewell>()->number = 7;
  CHECK(Farewell::destroyed == 1);
  const int before = Counting::destroyed;
  for (int n = 0; n < 100; ++n) {
    auto message = pusher.loan();
    message->members.resize(3);
    message->members[1].text = kLong;
    must_go(pusher.push(std::move(message)));
  }
  // All but those that wait for the next loan to look at them.
  CHECK(Counting::destroyed > before);
  CHECK(Counting::destroyed % 3 == 0);
  CHECK(Counting::destroyed <= before + 300);
}

TEST_CASE("many ShmRef in vectors, also to messages that refer to others") {
  const Watchdog watchdog(60);
  Place place;
  lot::segment::Segment s(place.engine.path());
  {
    auto pusher = place.engine.advertise<Detections>("/d", {lot::Policy::Overwrite, 1, 1s});
    auto puller = place.engine.subscribe<Detections>("/d");
    for (int round = 0; round < 20; ++round) {
      auto all = pusher.loan();
      for (std::uint64_t n = 0; n < 100; ++n) {
        auto target = place.engine.make<Target>();
        target->number = n;
        target->data.assign(100, n);
        const lot::ShmSharedPtr<const Target> shared = std::move(target);
        all->refs.push_back(shared);
        all->refs.emplace_back(shared);
        all->all.emplace_back();
        all->all.back().frame = shared;
        all->all.push_back(Detection{lot::ShmRef<const Target>(shared), {}});
      }
      must_go(pusher.push(std::move(all)));
      auto seen = puller.pull(1s);
      REQUIRE(seen);
      for (std::uint64_t n = 0; n < 100; ++n) {
        REQUIRE(seen->refs[2 * n]->number == n);
        REQUIRE(seen->refs[2 * n + 1]->data[99] == n);
        REQUIRE(seen->all[2 * n].frame->data[0] == n);
        REQUIRE(seen->all[2 * n + 1].frame.get() == seen->refs[2 * n].get());
      }
    }
  }
  // The engine keeps the targets' blocks for its next messages; nobody else has them.
  CHECK(eventually([&] {
    const Audit now(s);
    return now.own_bits == now.homes && now.channels == 0;
  }));
  lot::ShmWeakPtr<const Target> last;
  {
    auto pusher = place.engine.advertise<Detections>("/d", {lot::Policy::Overwrite, 1, 1s});
    const lot::ShmSharedPtr<const Target> shared = place.engine.make<Target>();
    last = shared;
    auto all = pusher.loan();
    all->refs.push_back(shared);
    must_go(pusher.push(std::move(all)));
  }
  CHECK(eventually([&] { return last.expired(); }));
}

TEST_CASE("a ShmRef stays good when its publisher is killed, and its target is freed after") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined;
  Child publisher([&] {
    must(joined.next() == '.', "a reader");
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Detection>("/d");
    must(pusher.wait_for_readers(1, 10s), "it joined");
    auto target = engine.make<Target>();
    target->number = 7;
    target->data.assign(100000, 7);
    const lot::ShmSharedPtr<const Target> shared = std::move(target);
    auto detection = pusher.loan();
    detection->frame = shared;
    must_go(pusher.push(std::move(detection)));
    kill(getpid(), SIGKILL);
  });
  {
    lot::ShmEngine engine(options);
    lot::segment::Segment s(engine.path());
    auto puller = engine.subscribe<Detection>("/d");
    joined.tell();
    auto seen = puller.pull(20s);
    REQUIRE(seen);
    CHECK(publisher.wait() == 128 + SIGKILL);
    CHECK(eventually([&] { return Audit(s).participants == 1; }));
    (void)puller.pull(10ms);  // leaves the dead publisher's ring
    std::this_thread::sleep_for(1300ms);
    CHECK(seen->frame->data.size() == 100000);
    CHECK(seen->frame->data[99999] == 7);
    auto target = seen->frame.lock();
    seen.reset();
    std::this_thread::sleep_for(1300ms);
    CHECK(target->data[99999] == 7);
    target.reset();
    CHECK(eventually([&] { return Audit(s).homes == 0; }));
    CHECK(Audit(s).own_bits == 0);
    CHECK(Audit(s).granules == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a ShmRef into another segment is refused") {
  Place here;
  Place there;
  auto pusher = here.engine.advertise<Detection>("/d");
  const lot::ShmSharedPtr<const Target> other = there.engine.make<Target>();
  auto detection = pusher.loan();
  CHECK_THROWS_AS(detection->frame = other, lot::Error);
  CHECK(!detection->frame);
}

TEST_CASE("a message whose constructor throws gives its memory back, however often it does") {
  const Watchdog watchdog(60);
  Place place(32 << 20);
  auto pusher = place.engine.advertise<Failing>("/t");
  for (int n = 0; n < 100; ++n) CHECK_THROWS_AS((void)pusher.loan(true), std::runtime_error);
  auto message = pusher.loan(false);
  REQUIRE(message);
  CHECK(message->data.size() == 1 << 20);
}

TEST_CASE("a ShmRef to a message with a ShmRef keeps the whole chain") {
  const Watchdog watchdog(60);
  struct Link {
    std::uint64_t number;
    lot::ShmRef<const Detection> next;
  };
  Place place;
  auto pusher = place.engine.advertise<Link>("/l", {lot::Policy::Overwrite, 1, 1s});
  auto puller = place.engine.subscribe<Link>("/l");
  lot::ShmWeakPtr<const Target> watch;
  {
    auto target = place.engine.make<Target>();
    target->number = 3;
    const lot::ShmSharedPtr<const Target> t = std::move(target);
    watch = t;
    auto detection = place.engine.make<Detection>();
    detection->frame = t;
    const lot::ShmSharedPtr<const Detection> d = std::move(detection);
    auto link = pusher.loan();
    link->next = d;
    must_go(pusher.push(std::move(link)));
  }
  auto seen = puller.pull(1s);
  CHECK(seen->next->frame->number == 3);
  seen.reset();
  for (int n = 0; n < 100; ++n) must_go(pusher.push(pusher.loan()));
  CHECK(watch.expired());
}

TEST_CASE("a ShmRef that is assigned again lets its former target go while its message is built") {
  Place place;
  const auto make = [&](std::uint64_t number) {
    auto target = place.engine.make<Target>();
    target->number = number;
    target->data.assign(100, number);
    return lot::ShmSharedPtr<const Target>(std::move(target));
  };
  auto pusher = place.engine.advertise<Detections>("/d", {lot::Policy::Overwrite, 1, 1s});
  auto message = pusher.loan();
  lot::ShmSharedPtr<const Target> shared = make(1);
  const lot::ShmWeakPtr<const Target> first = shared;
  message->refs.push_back(shared);
  message->refs.push_back(shared);
  message->all.emplace_back();
  message->all[0].frame = shared;
  message->all[0].frame = shared;
  for (int n = 0; n < 50; ++n) message->refs.push_back(message->refs.back());  // the vector moves
  shared = make(2);
  const lot::ShmWeakPtr<const Target> second = shared;
  CHECK(!first.expired());
  message->refs.erase(message->refs.begin(), message->refs.end() - 1);
  message->all[0].frame = shared;
  CHECK(!first.expired());  // the last one of the vector
  CHECK(message->refs[0]->data[99] == 1);
  message->refs[0] = shared;
  CHECK(first.expired());
  CHECK(message->refs[0]->data[99] == 2);
  shared.reset();
  message->refs.pop_back();
  CHECK(!second.expired());
  message->all[0].frame = message->all[0].frame;
  CHECK(!second.expired());
  message->all[0].frame = lot::ShmRef<const Target>();
  CHECK(second.expired());
  CHECK(!message->all[0].frame);

  // What it refers to when it is published lives as long as it does.
  shared = make(3);
  const lot::ShmWeakPtr<const Target> third = shared;
  message->all[0].frame = shared;
  shared.reset();
  lot::ShmSharedPtr<Detections> kept = std::move(message);
  CHECK(pusher.push(kept) == lot::Status::Ok);
  CHECK_THROWS_AS(kept->all[0].frame = make(4), lot::Error);
  kept->all[0].frame = lot::ShmRef<const Target>();
  CHECK(!third.expired());
  kept.reset();
  for (int n = 0; n < 100; ++n) must_go(pusher.push(pusher.loan()));
  CHECK(third.expired());
}

TEST_CASE("a ShmRef in a message may change as often as it likes") {
  const Watchdog watchdog(60);
  Place place;
  auto message = place.engine.make<Detections>();
  message->refs.resize(20);
  lot::segment::Segment s(place.engine.path());
  const std::size_t before = Audit(s).granules;
  for (std::uint64_t n = 0; n < 20000; ++n) {
    auto target = place.engine.make<Target>();
    target->number = n;
    message->refs[n % 20] = lot::ShmSharedPtr<const Target>(std::move(target));
  }
  for (std::uint64_t n = 0; n < 20; ++n) CHECK(message->refs[n]->number == 20000 - 20 + n);
  const Audit after(s);
  CHECK(after.homes < 100);
  CHECK(after.granules < before + 10);
}

TEST_CASE("many ShmRef of a message to one other take no more memory than one") {
  Place place;
  const lot::ShmSharedPtr<const Target> target = place.engine.make<Target>();
  auto message = place.engine.make<Detections>();
  message->refs.reserve(2000);
  message->refs.emplace_back(target);
  lot::segment::Segment s(place.engine.path());
  const std::size_t before = Audit(s).granules;
  while (message->refs.size() < 2000) message->refs.emplace_back(target);
  CHECK(Audit(s).granules == before);
  message->refs.resize(1);
  CHECK(message->refs[0].get() == target.get());
}

TEST_CASE("a message may refer to all other messages that its segment has room for") {
  const Watchdog watchdog(60);
  lot::EngineOptions options = fresh();
  options.blocks = 66;  // such that each of the lists that a message can have is needed
  lot::ShmEngine engine(options);
  std::vector<lot::ShmWeakPtr<const Target>> targets;
  {
    auto message = engine.make<Detections>();
    message->refs.reserve(options.blocks);
    try {
      for (std::uint64_t n = 0;; ++n) {
        lot::ShmSharedPtr<Target> target = engine.make<Target>();
        target->number = n;
        message->refs.emplace_back(lot::ShmSharedPtr<const Target>(target));
        targets.emplace_back(lot::ShmSharedPtr<const Target>(target));
      }
    } catch (const lot::OutOfMemory&) {
    }
    CHECK(targets.size() == options.blocks - 1);
    for (std::uint64_t n = 0; n < targets.size(); ++n) {
      CHECK(message->refs[n]->number == n);
      CHECK(!targets[n].expired());
    }
    // Half of the references go again while it is built. Others take their places.
    for (std::uint64_t n = 0; n < targets.size(); n += 2) message->refs[n] = message->refs[1];
    for (std::uint64_t n = 0; n < targets.size(); ++n) CHECK(targets[n].expired() == (n % 2 == 0));
    CHECK(message->refs[1]->number == 1);
    for (std::uint64_t n = 0; n < targets.size(); n += 2) {
      message->refs[n] = lot::ShmSharedPtr<const Target>(engine.make<Target>());
    }
    CHECK(!targets[1].expired());
  }
  for (const auto& target : targets) CHECK(target.expired());
  // All blocks serve again.
  std::vector<lot::ShmUniquePtr<Target>> again;
  for (std::uint32_t n = 0; n < options.blocks; ++n) again.push_back(engine.make<Target>());
}

TEST_CASE("a ShmRef to a part of a message is good, to anything else it is refused") {
  Place place;
  auto target = place.engine.make<Target>();
  target->data.assign(1000, 7);
  const lot::ShmSharedPtr<Target> shared = std::move(target);
  const lot::ShmSharedPtr<Target> other = place.engine.make<Target>();
  const Target mine{};
  using Shared = lot::ShmSharedPtr<const Target>;
  auto message = place.engine.make<Detection>();
  message->frame = shared;
  for (const Target* const part : {&mine, static_cast<const Target*>(other.get())}) {
    CHECK_THROWS_AS(message->frame = Shared(shared, part), lot::Error);
    CHECK(message->frame.get() == shared.get());
  }
  struct Parts {
    lot::ShmRef<const std::uint64_t> member;
    lot::ShmRef<const std::uint64_t> element;
  };
  auto parts = place.engine.make<Parts>();
  parts->member = lot::ShmSharedPtr<const std::uint64_t>(shared, &shared->number);
  parts->element = lot::ShmSharedPtr<const std::uint64_t>(shared, &shared->data[999]);
  CHECK(*parts->element == 7);
  CHECK(*parts->element.lock() == 7);
  const lot::ShmSharedPtr<const std::uint64_t> none(shared, static_cast<std::uint64_t*>(nullptr));
  parts->element = none;
  CHECK(!parts->element);
}

TEST_CASE("a chain of ShmRef dies on a small stack, however long it is") {
  const Watchdog watchdog(60);
  struct Link {
    lot::ShmRef<const Link> before;
  };
  Place place(128 << 20);
  constexpr unsigned kLinks = 12000;
  lot::ShmSharedPtr<const Link> last;
  lot::ShmWeakPtr<const Link> first;
  for (unsigned n = 0; n < kLinks; ++n) {
    auto link = place.engine.make<Link>();
    if (last) link->before = last;
    last = std::move(link);
    if (n == 0) first = last;
  }
  pthread_attr_t small;
  REQUIRE(pthread_attr_init(&small) == 0);
  REQUIRE(pthread_attr_setstacksize(&small, 128 << 10) == 0);
  pthread_t thread{};
  const auto drop = [](void* link) -> void* {
    static_cast<lot::ShmSharedPtr<const Link>*>(link)->reset();
    return nullptr;
  };
  REQUIRE(pthread_create(&thread, &small, drop, &last) == 0);
  REQUIRE(pthread_join(thread, nullptr) == 0);
  CHECK(first.expired());
  for (unsigned n = 0; n < kLinks; ++n)
    CHECK(place.engine.make<Link>());  // all of it is there again
}

TEST_CASE("a process leaves though its last messages let others go only then") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  std::atomic<bool> held{false};
  std::thread neighbour;
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Detection>("/d", {lot::Policy::Overwrite, 1, 1s});
    for (int n = 0; n < 3; ++n) {
      auto detection = pusher.loan();
      detection->frame = lot::ShmSharedPtr<const Target>(engine.make<Target>());
      must_go(pusher.push(std::move(detection)));
    }
    // Somebody acts for the orphanage just now, so that the ring can not be closed at once.
    neighbour =
        std::thread([lock = std::make_unique<lot::liveness::LockFile>(engine.path() + ".lock"),
                     &held]() mutable {
          held = lock->try_lock(lot::refcount::kOrphanage);
          std::this_thread::sleep_for(500ms);
          lock.reset();
        });
    REQUIRE(eventually([&] { return held.load(); }));
  }
  neighbour.join();
  CHECK(eventually([&] { return files_of(options) == 0; }));
}

TEST_SUITE_END();
