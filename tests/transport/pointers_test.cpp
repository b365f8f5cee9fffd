// SPDX-License-Identifier: Apache-2.0

// The whole interface of the pointers, in one process and across several.

#include <array>
#include <cerrno>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <sched.h>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <type_traits>
#include <unordered_set>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

/// Its alignment keeps it out of the slots: the tests are of pointers to one message in a block.
struct alignas(32) Pair {
  std::uint64_t a;
  std::uint64_t b;
};
struct Text {
  std::uint64_t number;
  lot::ShmString text;
};
struct Large {
  Pair first;
  char bytes[1000];
  Pair last;
};
struct Derived : Pair {};
struct Linked {
  std::uint64_t number;
  lot::ShmString text;
  lot::ShmRef<const Linked> next;
};
/// Says how many its process has destroyed.
struct Mortal {
  std::uint64_t number = 0;
  ~Mortal() { ++destroyed; }
  static inline std::uint64_t destroyed = 0;
};
/// With a table that a conversion to the base looks into.
struct Base {
  std::uint64_t number = 0;
};
struct Virtual : virtual Base {};

[[maybe_unused]] const std::string& prefix_taken = prefix();

using Unique = lot::ShmUniquePtr<Pair>;
using Shared = lot::ShmSharedPtr<Pair>;
using Const = lot::ShmSharedPtr<const Pair>;
using Weak = lot::ShmWeakPtr<Pair>;

static_assert(!std::is_copy_constructible_v<Unique> && !std::is_copy_assignable_v<Unique>);
static_assert(std::is_nothrow_move_constructible_v<Unique>);
static_assert(std::is_nothrow_move_constructible_v<Shared>);
static_assert(std::is_convertible_v<Shared, Const> && !std::is_convertible_v<Const, Shared>);
static_assert(std::is_convertible_v<Unique, Const> && std::is_convertible_v<Unique, Shared>);
static_assert(!std::is_convertible_v<Shared, lot::ShmSharedPtr<int>>);
static_assert(std::is_convertible_v<Shared, Weak> && !std::is_convertible_v<Weak, Shared>);
static_assert(std::is_constructible_v<Shared, Weak>);
static_assert(std::is_same_v<Const::element_type, const Pair>);
static_assert(std::is_same_v<Shared::weak_type, Weak>);

/// errno of the lot::Error that `f` throws, 0: none.
template <class F>
int error_of(F&& f) {
  try {
    f();
  } catch (const lot::Error& e) {
    return e.error_number();
  }
  return 0;
}

struct OwnerLess {
  template <class A, class B>
  bool operator()(const A& a, const B& b) const {
    return a.owner_before(b);
  }
};
template <class A, class B>
bool same_owner(const A& a, const B& b) {
  return !a.owner_before(b) && !b.owner_before(a);
}

struct Place {
  Place() : options(fresh()), engine(std::make_unique<lot::ShmEngine>(options)) {}
  ~Place() {
    engine.reset();
    CHECK(files_of(options) == 0);
  }
  Shared make(std::uint64_t a) { return engine->make<Pair>(a, a + 1); }
  Audit audit() {
    lot::segment::Segment s(options.directory + "/" + options.segment);
    return Audit(s);
  }
  lot::EngineOptions options;
  std::unique_ptr<lot::ShmEngine> engine;
};

}  // namespace

template <>
struct lot::is_trusted_message<Derived> : std::true_type {};
template <>
struct lot::is_trusted_message<Mortal> : std::true_type {};
template <>
struct lot::is_trusted_message<Virtual> : std::true_type {};

TEST_SUITE_BEGIN("pointers");

TEST_CASE("null and moved-from pointers, unique, shared and weak, behave") {
  Place place;
  Unique u;
  CHECK(!u);
  CHECK(u.get() == nullptr);
  u.reset();
  u = nullptr;
  Unique from_null = nullptr;
  swap(u, from_null);
  const Shared from_empty = std::move(u);
  CHECK(!from_empty);
  CHECK(from_empty.use_count() == 0);

  Shared s;
  const Shared n = nullptr;
  CHECK(s == n);
  CHECK(s == nullptr);
  CHECK(nullptr == s);
  CHECK_FALSE(s != nullptr);
  CHECK_FALSE(nullptr != s);
  CHECK(!s.unique());
  s.reset();
  s = n;
  CHECK(lot::make_const(s) == nullptr);
  CHECK(lot::static_pointer_cast<const Pair>(s) == nullptr);
  CHECK(lot::to_raw_pointer(s) == nullptr);
  CHECK(std::hash<Shared>()(s) == std::hash<Pair*>()(nullptr));
  const Shared aliased_null(s, static_cast<Pair*>(nullptr));
  CHECK(aliased_null.use_count() == 0);

  Weak w;
  CHECK(w.expired());
  CHECK(w.use_count() == 0);
  CHECK(w.lock() == nullptr);
  w.reset();
  w = s;
  CHECK(w.expired());
  CHECK_THROWS_AS(Shared{w}, std::bad_weak_ptr);

  s = place.make(1);
  Shared moved = std::move(s);
  CHECK(s == nullptr);
  CHECK(s.use_count() == 0);
  CHECK(moved.use_count() == 1);
  s = std::move(moved);
  CHECK(moved == nullptr);
  CHECK(s->a == 1);
  Shared& self = s;
  s = self;
  CHECK(s->a == 1);
  CHECK(s.unique());
  w = s;
  Weak v = std::move(w);
  CHECK(w.expired());
  CHECK(!v.expired());
}

TEST_CASE("a ShmUniquePtr owns, moves, swaps, frees and becomes a ShmSharedPtr without a copy") {
  Place place;
  Unique u = place.engine->make<Pair>(std::uint64_t{1}, std::uint64_t{2});
  const Pair* address = u.get();
  CHECK((*u).a == 1);
  CHECK(u->b == 2);
  Unique v = std::move(u);
  CHECK(!u);
  CHECK(v.get() == address);
  u = place.engine->make<Pair>(std::uint64_t{3}, std::uint64_t{4});
  swap(u, v);
  CHECK(u.get() == address);
  v.swap(u);
  CHECK(v.get() == address);
  u = std::move(v);
  CHECK(u.get() == address);
  CHECK(!v);
  Const c = std::move(u);
  CHECK(c.get() == address);
  CHECK(c.use_count() == 1);
  u = place.engine->make<Pair>(std::uint64_t{5}, std::uint64_t{6});
  c = std::move(u);
  CHECK(c->a == 5);
  Unique w = place.engine->make<Pair>();
  w = nullptr;
  CHECK(!w);
}

TEST_CASE("a ShmUniquePtr converts to const and to a base, compares, hashes and prints") {
  Place place;
  Unique u = place.engine->make<Pair>(std::uint64_t{1}, std::uint64_t{2});
  const Pair* const address = u.get();
  CHECK(u != nullptr);
  CHECK(nullptr != u);
  lot::ShmUniquePtr<const Pair> c = std::move(u);
  CHECK(u == nullptr);
  CHECK(nullptr == u);
  CHECK(c.get() == address);
  u = place.engine->make<Pair>();
  c = std::move(u);
  CHECK(u == nullptr);
  CHECK(c == c);
  CHECK(c != u);
  CHECK((c < u) == (c.get() < u.get()));
  CHECK((c <= u) != (c > u));
  CHECK((c >= u) != (c < u));
  CHECK(std::hash<lot::ShmUniquePtr<const Pair>>()(c) == std::hash<const Pair*>()(c.get()));
  std::ostringstream out, raw;
  out << c;
  raw << static_cast<const void*>(c.get());
  CHECK(out.str() == raw.str());
  const lot::ShmSharedPtr shared(std::move(c));
  static_assert(std::is_same_v<decltype(shared), const Const>);
  CHECK(c == nullptr);
#if __cplusplus >= 202002L
  CHECK((shared <=> shared) == 0);
  CHECK((shared <=> Const()) != 0);
#endif
}

template <class Pointer>
void check_order_with_null(const Pointer& none, const Pointer& some) {
  CHECK_FALSE(none < nullptr);
  CHECK_FALSE(nullptr < none);
  CHECK_FALSE(none > nullptr);
  CHECK_FALSE(nullptr > none);
  CHECK(none <= nullptr);
  CHECK(nullptr <= none);
  CHECK(none >= nullptr);
  CHECK(nullptr >= none);
  CHECK(nullptr < some);
  CHECK_FALSE(some < nullptr);
  CHECK(some > nullptr);
  CHECK_FALSE(nullptr > some);
  CHECK(nullptr <= some);
  CHECK_FALSE(some <= nullptr);
  CHECK(some >= nullptr);
  CHECK_FALSE(nullptr >= some);
#if __cplusplus >= 202002L
  CHECK((none <=> nullptr) == 0);
  CHECK((some <=> nullptr) > 0);
  CHECK((nullptr <=> some) < 0);
#endif
}

TEST_CASE("pointers are ordered with nullptr, as std's pointers are") {
  Place place;
  check_order_with_null(Unique(), place.engine->make<Pair>());
  const lot::ShmSharedPtr<Pair> shared = place.engine->make<Pair>();
  check_order_with_null({}, shared);
  check_order_with_null(lot::ShmRef<Pair>(), lot::ShmRef<Pair>(shared));
}

TEST_CASE("a push of a ShmUniquePtr to a base is refused: readers get whole messages") {
  Place place;
  auto pusher = place.engine->advertise<Pair>("/t");
  auto puller = place.engine->subscribe<Pair>("/t");
  lot::ShmUniquePtr<Derived> derived = place.engine->make<Derived>();
  Unique base = std::move(derived);
  CHECK(error_of([&] { must_go(pusher.push(std::move(base))); }) == EINVAL);
  CHECK(base != nullptr);
  base.reset();
  CHECK(!puller.try_pull());
  must_go(pusher.push(pusher.loan(std::uint64_t{1}, std::uint64_t{2})));
  CHECK(puller.try_pull()->b == 2);
}

TEST_CASE("a ShmRef compares with pointers, converts, swaps, hashes and lets go") {
  Place place;
  using Ref = lot::ShmRef<const Linked>;
  lot::ShmSharedPtr<Linked> one = place.engine->make<Linked>();
  lot::ShmSharedPtr<Linked> two = place.engine->make<Linked>();
  auto message = place.engine->make<Linked>();
  Ref mine = one;
  CHECK(mine == one);
  CHECK(one == mine);
  CHECK(mine != two);
  CHECK(mine != nullptr);
  message->next = two;
  CHECK(message->next == two);
  swap(mine, message->next);  // one is in private memory, the other in a message
  CHECK(mine == two);
  CHECK(message->next == one);
  CHECK(std::hash<Ref>()(message->next) == std::hash<const Linked*>()(one.get()));
  const lot::ShmRef<Linked> changeable = two;
  mine = nullptr;
  CHECK(mine == nullptr);
  mine = changeable;
  CHECK(mine == changeable);
  const Ref constant = changeable;
  CHECK(constant == two);
  mine.reset();
  CHECK(!mine);
  message->next = nullptr;
  CHECK(message->next == nullptr);
  const lot::ShmWeakPtr weak(one);
  one.reset();
  CHECK(weak.expired());  // no reference has kept it
}

TEST_CASE("owner_less orders what shares a message, dead or alive, also by std's name") {
  Place place;
  const Shared s = place.make(1);
  const lot::ShmSharedPtr<std::uint64_t> part(s, &s->b);
  const Weak weak = s;
  CHECK(!lot::owner_less()(s, part));
  CHECK(!lot::owner_less()(part, weak));
  CHECK(!lot::owner_less()(weak, s));
  std::set<Weak, std::owner_less<Weak>> set{weak, Weak(s), Weak(place.make(3))};
  CHECK(set.size() == 2);
  CHECK(set.find(s) != set.end());
}

TEST_CASE("a ShmWeakPtr converts by move; dynamic_pointer_cast and deduction keep the message") {
  Place place;
  lot::ShmSharedPtr<Derived> derived = place.engine->make<Derived>();
  lot::ShmWeakPtr<Derived> weak(derived);
  Weak base(std::move(weak));
  CHECK(base.lock() == derived);
  CHECK(weak.expired());
  weak = derived;
  base = weak;
  CHECK(base.lock() == derived);
  base.reset();
  base = std::move(weak);
  CHECK(base.lock() == derived);
  CHECK(weak.expired());
  const lot::ShmSharedPtr again(base);
  static_assert(std::is_same_v<decltype(again), const Shared>);
  CHECK(again == derived);
  const auto up = lot::dynamic_pointer_cast<Pair>(derived);
  CHECK(up == again);
  CHECK(up.use_count() == 3);
}

TEST_CASE("copies of a ShmSharedPtr count, convert, alias, cast, compare, hash and print") {
  Place place;
  Shared s = place.make(1);
  const Shared other = place.make(5);
  {
    const Shared copy = s;
    const Const constant = s;
    CHECK(s.use_count() == 3);
    CHECK(!s.unique());
    CHECK(copy == s);
    CHECK(constant == s);
    Const assigned;
    assigned = s;
    assigned = constant;
    CHECK(s.use_count() == 4);
  }
  CHECK(s.unique());

  // Aliasing keeps the whole alive, also by a part or by null.
  lot::ShmSharedPtr<std::uint64_t> part(s, &s->b);
  CHECK(*part == 2);
  CHECK(part.use_count() == 2);
  CHECK_FALSE(part.owner_before(s));
  CHECK_FALSE(s.owner_before(part));
  CHECK(s.owner_before(other) != other.owner_before(s));
  const Pair* address = s.get();
  s.reset();
  CHECK(*part == 2);
  CHECK(part.unique());
  lot::ShmSharedPtr<std::uint64_t> moved_part(std::move(part), part.get() - 1);
  CHECK(part == nullptr);
  CHECK(*moved_part == 1);
  Shared null_part(moved_part, static_cast<Pair*>(nullptr));
  CHECK(null_part == nullptr);
  CHECK(null_part.use_count() == 2);
  null_part.reset();

  s = lot::reinterpret_pointer_cast<Pair>(moved_part);
  CHECK(s.get() == address);
  CHECK(s.use_count() == 2);
  moved_part.reset();
  const Const constant = lot::make_const(s);
  CHECK(constant.get() == address);
  CHECK(lot::const_pointer_cast<Pair>(constant) == s);
  CHECK(lot::static_pointer_cast<const Pair>(s) == constant);
  CHECK(lot::to_raw_pointer(s) == address);
  CHECK(lot::make_const(std::move(s)).get() == address);
  CHECK(s == nullptr);
  s = lot::const_pointer_cast<Pair>(constant);

  CHECK(s != other);
  CHECK((s < other) == (s.get() < other.get()));
  CHECK((s > other) == (s.get() > other.get()));
  CHECK((s <= other) == (s.get() <= other.get()));
  CHECK((s >= other) == (s.get() >= other.get()));
  CHECK(s <= constant);
  CHECK(std::hash<Const>()(constant) == std::hash<const Pair*>()(address));
  std::unordered_set<Shared> set{s, other, s};
  CHECK(set.size() == 2);
  std::ostringstream out, raw;
  out << s;
  raw << address;
  CHECK(out.str() == raw.str());
  Shared a = s;
  Shared b = other;
  swap(a, b);
  CHECK(a == other);
  a.swap(b);
  CHECK(a == s);
}

TEST_CASE("a ShmWeakPtr does not keep the message alive, nor takes the next one in its memory") {
  Place place;
  Shared s = place.make(1);
  const Weak w = s;
  const lot::ShmWeakPtr<const Pair> c = w;
  Weak copy;
  copy = w;
  CHECK(w.use_count() == 1);
  CHECK(s.unique());
  CHECK(!w.expired());
  CHECK(w.lock() == s);
  CHECK(Shared(w)->a == 1);
  CHECK(c.lock()->b == 2);
  CHECK_FALSE(w.owner_before(s));
  CHECK_FALSE(s.owner_before(w));
  CHECK_FALSE(w.owner_before(copy));
  const Pair* address = s.get();
  s.reset();
  CHECK(w.expired());
  CHECK(w.lock() == nullptr);
  CHECK(w.use_count() == 0);
  CHECK_THROWS_AS(Shared{w}, std::bad_weak_ptr);
  std::vector<Shared> more;
  for (std::uint64_t n = 0; n < 10; ++n) more.push_back(place.make(n));
  bool same_memory = false;
  for (const auto& m : more) same_memory |= m.get() == address;
  CHECK(same_memory);
  CHECK(w.expired());
  CHECK(w.lock() == nullptr);
  CHECK(copy.lock() == nullptr);
  Weak other = more[0];
  swap(copy, other);
  CHECK(copy.lock() == more[0]);
}

TEST_CASE("a message that only the queue holds has not expired for a weak pointer, ShmWeakPtr") {
  Place place;
  auto pusher = place.engine->advertise<Pair>("/t", {lot::Policy::Overwrite, 2, 1s});
  Shared s = pusher.loan(std::uint64_t{1}, std::uint64_t{2});
  must_go(pusher.push(s));
  const Weak w = s;
  s.reset();
  CHECK(!w.expired());
  CHECK(w.lock()->a == 1);
  for (std::uint64_t n = 0; n < 200; ++n) must_go(pusher.push(pusher.loan(n, n)));
  CHECK(w.lock() == nullptr);
}

TEST_CASE("use_count says one for each other process that has pointers") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined, kept, go, dropped, end;
  const auto reader = [&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Pair>("/t");
    joined.tell();
    auto seen = puller.pull(20s);
    must(bool(seen), "a message");
    const auto again = seen;
    kept.tell();
    must(go.next() == '.', "both have it");
    must(seen.use_count() == 4, "two here, two elsewhere");
    dropped.tell();
    must(end.next() == '.', "the end");
  };
  Child first(reader), second(reader);
  REQUIRE(joined.next() == '.');
  REQUIRE(joined.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Pair>("/t");
    REQUIRE(pusher.wait_for_readers(2, 10s));
    Shared s = pusher.loan(std::uint64_t{1}, std::uint64_t{2});
    CHECK(s.unique());
    must_go(pusher.push(s));
    CHECK(kept.next() == '.');
    CHECK(kept.next() == '.');
    CHECK(s.use_count() == 3);
    const Weak w = s;
    CHECK(w.use_count() == 3);
    go.tell();
    go.tell();
    CHECK(dropped.next() == '.');
    CHECK(dropped.next() == '.');
    end.tell();
    end.tell();
    CHECK(first.wait() == 0);
    CHECK(second.wait() == 0);
    CHECK(s.use_count() == 1);
    CHECK_FALSE(s.unique());  // the queue has it
    s.reset();
    CHECK(!w.expired());  // the queue has it
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a kept message outlives its subscription, its publisher and its publisher's death") {
  const Watchdog watchdog(60);
  for (const bool killed : {false, true}) {
    CAPTURE(killed);
    const auto options = fresh();
    Steps joined, go;
    Child publisher([&] {
      must(joined.next() == '.', "a reader");
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Text>("/t");
      must(pusher.wait_for_readers(1, 10s), "a reader joined");
      auto text = pusher.loan();
      text->number = 7;
      text->text.assign(100000, 'x');
      must_go(pusher.push(std::move(text)));
      go.next();
      if (killed) kill(getpid(), SIGKILL);
    });
    {
      lot::ShmEngine engine(options);
      lot::ShmSharedPtr<const Text> kept;
      lot::ShmWeakPtr<const Text> weak;
      {
        auto puller = engine.subscribe<Text>("/t");
        joined.tell();
        kept = puller.pull(20s);
        REQUIRE(kept);
        weak = kept;
      }
      go.tell();
      CHECK(publisher.wait() == (killed ? 128 + SIGKILL : 0));
      lot::segment::Segment s(engine.path());
      CHECK(eventually([&] { return Audit(s).participants == 1; }));
      std::this_thread::sleep_for(1300ms);
      CHECK(kept->number == 7);
      CHECK(kept->text == lot::ShmString(100000, 'x'));
      CHECK(eventually([&] { return kept.unique(); }));
      // It can still be sent.
      auto pusher = engine.advertise<Text>("/again");
      auto puller = engine.subscribe<Text>("/again");
      CHECK(pusher.push(kept) == lot::Status::Ok);
      CHECK(puller.pull(1s).get() == kept.get());
      kept.reset();
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("pointers outlive their ShmEngine, and the process leaves with the last of them") {
  const auto options = fresh();
  Shared s;
  Unique u;
  Weak w;
  {
    lot::ShmEngine engine(options);
    s = engine.make<Pair>(std::uint64_t{1}, std::uint64_t{2});
    u = engine.make<Pair>(std::uint64_t{3}, std::uint64_t{4});
    w = s;
  }
  CHECK(files_of(options) == 2);
  CHECK(s->b == 2);
  CHECK(u->b == 4);
  CHECK(w.lock() == s);
  s.reset();
  CHECK(files_of(options) == 2);
  u.reset();
  CHECK(files_of(options) == 0);
  CHECK(w.lock() == nullptr);  // the segment has gone from under it
  CHECK(w.expired());
  w.reset();
}

TEST_CASE("a weak pointer that outlives its engine does not keep the files for others") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready, done;
  Child other([&] {
    lot::ShmEngine engine(options);
    ready.tell();
    done.next();
  });
  REQUIRE(ready.next() == '.');
  Weak w;
  {
    lot::ShmEngine engine(options);
    const Shared s = engine.make<Pair>();
    w = s;
  }
  done.tell();
  CHECK(other.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("the last pointers of a process may go in several threads at once") {
  const Watchdog watchdog(60);
  for (int round = 0; round < 100; ++round) {
    const auto options = fresh(16 << 20);
    std::vector<Shared> kept;
    {
      lot::ShmEngine engine(options);
      for (std::uint64_t n = 0; n < 4; ++n) kept.push_back(engine.make<Pair>(n, n));
    }
    std::atomic<int> waiting{0};
    std::vector<std::thread> threads;
    for (auto& k : kept) {
      threads.emplace_back([&] {
        ++waiting;
        while (waiting != 4) {
        }
        k.reset();
      });
    }
    for (auto& t : threads) t.join();
    REQUIRE(eventually([&] { return files_of(options) == 0; }));
  }
}

TEST_CASE("messages give back what they held when they come home") {
  const Watchdog watchdog(60);
  Place place;
  auto pusher = place.engine->advertise<Text>("/t", {lot::Policy::Overwrite, 2, 1s});
  lot::ShmSharedPtr<Text> target = pusher.loan();
  const lot::ShmWeakPtr<Text> watch = target;
  target->text = "kept by nobody";
  target.reset();
  CHECK(watch.expired());
}

TEST_CASE("the next message in a dead one's memory has another owner") {
  Place place;
  Shared first = place.make(1);
  const Pair* const address = first.get();
  const Weak dead = first;
  const Weak same = dead;
  first.reset();
  std::vector<Shared> more;
  while (more.empty() || more.back().get() != address) {
    REQUIRE(more.size() < 1000);
    more.push_back(place.make(2));
  }
  const Shared& living = more.back();
  const Weak other = living;
  CHECK(same_owner(dead, same));
  CHECK(same_owner(living, other));
  CHECK_FALSE(same_owner(dead, other));
  CHECK_FALSE(same_owner(dead, living));
  CHECK(dead.owner_before(other) == dead.owner_before(living));
  CHECK(other.owner_before(dead) == living.owner_before(dead));
  const Weak none;
  CHECK(same_owner(none, Shared()));
  CHECK_FALSE(same_owner(none, dead));

  std::map<Weak, int, OwnerLess> by_owner;
  by_owner[dead] = 1;
  CHECK(by_owner.emplace(living, 2).second);
  for (const Shared& s : more) by_owner.emplace(s, 3);
  CHECK(by_owner.size() == more.size() + 1);
  CHECK(by_owner.at(same) == 1);
  CHECK(by_owner.at(other) == 2);
}

TEST_CASE("a push of what is not the whole message is refused, on a topic and in a queue") {
  Place place;
  auto pusher = place.engine->advertise<Pair>("/t");
  auto puller = place.engine->subscribe<Pair>("/t");
  auto queue = place.engine->queue<Const>("q");
  auto reader = place.engine->queue<Const>("q");
  reader.listen();
  const auto refused = [&](const Const& pointer) {
    return error_of([&] { return pusher.push(pointer); }) == EINVAL &&
           error_of([&] { return queue.put(pointer); }) == EINVAL &&
           error_of([&] { return queue.put(Const(pointer)); }) == EINVAL;
  };
  const lot::ShmSharedPtr<Large> large = place.engine->make<Large>();
  const lot::ShmSharedPtr<std::array<Pair, 3>> small = place.engine->make<std::array<Pair, 3>>();
  const Shared pair = place.make(1);
  const Shared other = place.make(3);
  const Pair mine{7, 8};
  CHECK(refused(Const()));
  CHECK(refused(Const(pair, static_cast<const Pair*>(nullptr))));
  CHECK(refused(Const(pair, &mine)));
  CHECK(refused(Const(pair, other.get())));
  CHECK(refused(Const(large, &large->last)));
  CHECK(refused(Const(large, &large->first)));
  CHECK(refused(Const(small, &(*small)[1])));
  CHECK(refused(Const(small, small->data())));  // of another type, though at the same place
  CHECK(refused(Const(lot::ShmSharedPtr<Derived>(place.engine->make<Derived>()))));
  CHECK(puller.try_pull() == nullptr);
  CHECK(reader.try_pop() == std::nullopt);
  // The message itself is published under any name that it has.
  CHECK(pusher.push(pair) == lot::Status::Ok);
  CHECK(pusher.push(lot::make_const(pair)) == lot::Status::Ok);
  CHECK(pusher.push(Const(pair, pair.get())) == lot::Status::Ok);
  CHECK(queue.put(pair) == lot::Status::Ok);
  for (int n = 0; n < 3; ++n) CHECK(puller.try_pull() == pair);
  CHECK(reader.try_pop().value() == pair);
}

TEST_CASE("what another process has made is published whole, not in parts") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined, done;
  Child maker([&] {
    lot::ShmEngine engine(options);
    auto large = engine.advertise<Large>("/large");
    auto pairs = engine.advertise<Pair>("/pairs");
    auto items = engine.queue<Unique>("items");
    must(joined.next() == '.', "a reader");
    must_go(large.push(large.loan()));
    must_go(pairs.push(pairs.loan()));
    must_go(items.put(items.make()));
    done.next();
  });
  {
    lot::ShmEngine engine(options);
    auto large = engine.subscribe<Large>("/large");
    auto pairs = engine.subscribe<Pair>("/pairs");
    auto items = engine.queue<Unique>("items");
    items.listen();
    joined.tell();
    const auto l = large.pull(20s);
    const auto p = pairs.pull(20s);
    const auto item = items.wait_and_pop_for(20s);
    REQUIRE(l);
    REQUIRE(p);
    REQUIRE(item);
    auto again = engine.advertise<Large>("/again/large");
    auto again_pairs = engine.advertise<Pair>("/again/pairs");
    CHECK(again.push(l) == lot::Status::Ok);
    CHECK(again_pairs.push(p) == lot::Status::Ok);
    CHECK(error_of([&] { return again_pairs.push(Const(l, &l->first)); }) == EINVAL);
    CHECK(error_of([&] { return again_pairs.push(Const(l, &l->last)); }) == EINVAL);
    CHECK(error_of([&] { return again_pairs.push(Const(p, p.get() + 1)); }) == EINVAL);
    CHECK(error_of([&] {
            return again.push(
                lot::ShmSharedPtr<const Large>(p, reinterpret_cast<const Large*>(p.get())));
          }) == EINVAL);
    done.tell();
    CHECK(maker.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a message that a shared pointer has published can not grow any more") {
  Place place;
  auto pusher = place.engine->advertise<Text>("/t", {lot::Policy::Refuse, 2, 0s});
  auto puller = place.engine->subscribe<Text>("/t");
  lot::ShmSharedPtr<Text> kept[3];
  for (auto& k : kept) {
    k = pusher.loan();
    k->text.assign(1000, 'a');
  }
  for (auto& k : kept) {  // the last one is refused: it stays as it was
    const bool published = pusher.push(k) == lot::Status::Ok;
    CHECK(published == (&k != &kept[2]));
    const char* const text = k->text.data();
    const auto grow = [&] { k->text.append(100000, 'b'); };
    CHECK(error_of(grow) == (published ? EPERM : 0));
    CHECK((k->text.data() == text) == published);
  }
  const auto seen = puller.try_pull();
  REQUIRE(seen == kept[0]);
  const char* const text = kept[0]->text.data();
  kept[0]->text.clear();
  CHECK(error_of([&] { kept[0]->text.reserve(100000); }) == EPERM);
  kept[0]->text.shrink_to_fit();
  CHECK(text[999] == 'a');  // its memory was not given to anything
  // The next message in that memory grows as any other does.
  for (auto& k : kept) k.reset();
  for (int n = 0; n < 100; ++n) {
    lot::ShmUniquePtr<Text> next = pusher.loan();
    next->text.assign(100000, 'c');
    (void)pusher.push(std::move(next));
    (void)puller.try_pull();  // makes room
  }
}

TEST_CASE("what a published message refers to can not grow any more, however far away") {
  Place place;
  auto pusher = place.engine->advertise<Linked>("/t");
  lot::ShmSharedPtr<Linked> links[4];
  for (auto& l : links) l = place.engine->make<Linked>();
  links[0]->next = links[1];
  links[1]->next = links[2];
  links[2]->next = links[1];
  auto message = pusher.loan();
  message->next = links[0];
  links[2]->text.assign(1000, 'a');  // the order of building is free
  CHECK(pusher.push(std::move(message)) == lot::Status::Ok);
  for (auto& l : links) {
    const bool published = &l != &links[3];
    CHECK(error_of([&] { l->text.assign(5000, 'b'); }) == (published ? EPERM : 0));
    CHECK(error_of([&] { l->next = links[3]; }) == (published ? EPERM : 0));
  }
  links[1]->next = lot::ShmRef<const Linked>();
  links[3].reset();
}

TEST_CASE("an item that one reader takes grows after it was put and taken") {
  Place place;
  auto first = place.engine->queue<lot::ShmUniquePtr<Text>>("first");
  auto second = place.engine->queue<lot::ShmUniquePtr<Text>>("second");
  first.listen();
  second.listen();
  must_go(first.put(first.make()));
  auto text = first.wait_and_pop();
  text->text.assign(1000, 'a');
  must_go(second.put(std::move(text)));
  text = second.wait_and_pop();
  text->text.assign(100000, 'b');
  CHECK(text->text.size() == 100000);
}

TEST_CASE("unique() is false while a queue, a reader or a message has the message") {
  Place place;
  auto pusher = place.engine->advertise<Pair>("/t", {lot::Policy::Overwrite, 1, 1s});
  auto refers = place.engine->advertise<Linked>("/l", {lot::Policy::Overwrite, 1, 1s});
  Shared s = place.make(1);
  CHECK(s.unique());
  {
    auto puller = place.engine->subscribe<Pair>("/t");
    must_go(pusher.push(s));
    CHECK(s.use_count() == 1);
    CHECK_FALSE(s.unique());
    auto borrow = puller.try_borrow();
    REQUIRE(borrow);
    for (std::uint64_t n = 0; n < 200; ++n) must_go(pusher.push(pusher.loan(n, n)));
    CHECK(s.use_count() == 1);
    CHECK_FALSE(s.unique());  // the borrow
    CHECK(borrow->a == 1);
  }
  for (std::uint64_t n = 0; n < 200; ++n) must_go(pusher.push(pusher.loan(n, n)));
  CHECK(s.unique());
  const Shared copy = s;
  CHECK_FALSE(s.unique());

  lot::ShmSharedPtr<Linked> target = place.engine->make<Linked>();
  {
    auto message = refers.loan();
    message->next = target;
    CHECK(target.use_count() == 1);
    CHECK_FALSE(target.unique());
  }
  CHECK(target.unique());
}

TEST_CASE("unique() is false while another process has the message, and where it was received") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined, kept, go, dropped, end;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Pair>("/t");
    auto items = engine.queue<Unique>("items");
    items.listen();
    joined.tell();
    auto seen = puller.pull(20s);
    must(bool(seen), "a message");
    must(!seen.unique(), "its maker may look at it");
    Shared item = items.wait_and_pop();
    must(item.unique(), "it was taken, so it is ours alone");
    {
      const Shared second = item;
      must(!item.unique(), "two pointers");
    }
    must(item.unique(), "one again");
    auto pusher = engine.advertise<Pair>("/items");
    must_go(pusher.push(item));
    must(!item.unique(), "it is in a queue");
    kept.tell();
    must(go.next() == '.', "go on");
    seen.reset();
    dropped.tell();
    must(end.next() == '.', "the end");
  });
  REQUIRE(joined.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Pair>("/t", {lot::Policy::Overwrite, 1, 1s});
    auto items = engine.queue<Unique>("items");
    REQUIRE(pusher.wait_for_readers(1, 10s));
    const Shared s = pusher.loan(std::uint64_t{1}, std::uint64_t{2});
    must_go(pusher.push(s));
    must_go(items.put(items.make()));
    REQUIRE(kept.next() == '.');
    for (std::uint64_t n = 0; n < 200; ++n) must_go(pusher.push(pusher.loan(n, n)));
    CHECK_FALSE(s.unique());
    go.tell();
    REQUIRE(dropped.next() == '.');
    CHECK(s.unique());
    end.tell();
    CHECK(reader.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

/// The maker of an item pulls it, after another process has taken it from a queue and published it.
/// `shared`: as a shared pointer. `first_back`: the maker has taken it back before, and publishes
/// it itself.
template <class T>
void check_published_item(bool shared, bool first_back) {
  const auto options = fresh();
  Steps joined, pulled, go, end;
  const auto publish = [&](lot::ShmEngine& engine, lot::ShmUniquePtr<T> item) {
    auto pusher = engine.advertise<T>("/t", {lot::Policy::Overwrite, 1, 1s});
    must(pusher.wait_for_readers(2, 20s), "two readers");
    if (shared) {
      must_go(pusher.push(lot::ShmSharedPtr<T>(std::move(item))));
    } else {
      must_go(pusher.push(std::move(item)));
    }
    return pusher;
  };
  const auto flush = [](lot::ShmPusher<T>& pusher) {  // so that no queue has the item
    for (int n = 0; n < 200; ++n) must_go(pusher.push(pusher.loan()));
  };
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<T>("/t");
    auto items = engine.queue<lot::ShmUniquePtr<T>>("items");
    auto back = engine.queue<lot::ShmUniquePtr<T>>("back");
    joined.tell();
    auto item = items.wait_and_pop();
    std::optional<lot::ShmPusher<T>> pusher;
    if (first_back) {
      must(back.put(std::move(item)) == lot::Status::Ok, "put back");
    } else {
      pusher.emplace(publish(engine, std::move(item)));
    }
    const auto seen = puller.pull(20s);
    must(bool(seen), "it is published");
    pulled.tell();
    must(go.next() == '.', "the maker has it and no queue has it any more");
    if (pusher) flush(*pusher);
    for (int n = 0; n < 200; ++n) {
      must(back.put(back.make()) == lot::Status::Ok && back.try_pop(), "put and popped");
    }
    must(seen.use_count() == 2, "the maker has a pointer");
    must(!seen.unique(), "and may look at it");
    must(end.next() == '.', "the end");
  });
  REQUIRE(joined.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<T>("/t");
    auto items = engine.queue<lot::ShmUniquePtr<T>>("items");
    auto back = engine.queue<lot::ShmUniquePtr<T>>("back");
    must_go(items.put(items.make()));
    std::optional<lot::ShmPusher<T>> pusher;
    if (first_back) pusher.emplace(publish(engine, back.wait_and_pop()));
    const auto seen = puller.pull(20s);
    REQUIRE(seen);
    REQUIRE(pulled.next() == '.');
    if (pusher) flush(*pusher);
    go.tell();
    CHECK_FALSE(seen.unique());
    end.tell();
    CHECK(reader.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("unique() is false for an item that was taken and published, which its maker has too") {
  const Watchdog watchdog(100);
  for (const bool shared : {false, true}) {
    for (const bool first_back : {false, true}) {
      CAPTURE(shared);
      CAPTURE(first_back);
      check_published_item<Pair>(shared, first_back);
      check_published_item<Large>(shared, first_back);
      check_published_item<Text>(shared, first_back);
    }
  }
}

TEST_CASE("a message in memory that was once taken from a queue is its maker's, too") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  constexpr int kItems = 80;
  Steps joined, taken, pushed, seen;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto items = engine.queue<Unique>("items");
    auto puller = engine.subscribe<Pair>("/t");
    joined.tell();
    for (int n = 0; n < kItems; ++n) items.wait_and_pop().reset();
    taken.tell();
    must(pushed.next() == '.', "published");
    int alone = 0;
    int all = 0;
    while (const Const message = puller.try_pull()) {
      ++all;
      alone += message.unique();
    }
    must(all != 0 && alone == 0, "none is ours alone");
    seen.tell();
  });
  REQUIRE(joined.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto items = engine.queue<Unique>("items");
    auto pusher = engine.advertise<Pair>("/t");
    for (int n = 0; n < kItems; ++n) must_go(items.put(items.make()));
    REQUIRE(taken.next() == '.');
    std::vector<Shared> kept;
    for (int n = 0; n < kItems; ++n) {  // in the memory of those that were taken
      kept.emplace_back(items.make());
      must_go(pusher.push(kept.back()));
    }
    pushed.tell();
    CHECK(seen.next() == '.');
    CHECK(reader.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

/// While it is there, this thread stays on the first or the last of its cores: two processes then
/// run at once, where there are two cores.
class OnCore {
 public:
  explicit OnCore(bool last) {
    sched_getaffinity(0, sizeof before_, &before_);
    cpu_set_t one;
    CPU_ZERO(&one);
    int chosen = -1;
    for (int k = 0; k < CPU_SETSIZE; ++k) {
      if (CPU_ISSET(k, &before_) && (last || chosen == -1)) chosen = k;
    }
    CPU_SET(chosen, &one);
    sched_setaffinity(0, sizeof one, &one);
  }
  ~OnCore() { sched_setaffinity(0, sizeof before_, &before_); }
  OnCore(const OnCore&) = delete;
  OnCore& operator=(const OnCore&) = delete;

 private:
  cpu_set_t before_;
};

TEST_CASE("an item that its maker takes back is destroyed, though other processes try for it") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  constexpr int kRounds = 20'000;
  Steps joined, end;
  Child other([&] {
    lot::ShmEngine engine(options);
    auto items = engine.queue<lot::ShmUniquePtr<Mortal>>("items");
    items.listen();
    const OnCore last(true);
    joined.tell();
    while (end.next(0ms) == 0) {
      for (int n = 0; n < 1000; ++n) (void)items.try_pop();
    }
  });
  REQUIRE(joined.next() == '.');
  std::uint64_t came_back = 0;
  Mortal::destroyed = 0;
  {
    lot::ShmEngine engine(options);
    auto items = engine.queue<lot::ShmUniquePtr<Mortal>>("items");
    const OnCore first(false);
    for (int round = 0; round < kRounds; ++round) {
      for (int n = 0; n < 32; ++n) must_go(items.put(items.make()));
      while (items.try_pop()) ++came_back;
    }
    end.tell();
    CHECK(other.wait() == 0);
  }
  CHECK(Mortal::destroyed == came_back);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a dead weak pointer converts to a virtual base without a look at the memory") {
  Place place;
  lot::ShmSharedPtr<Virtual> object = place.engine->make<Virtual>();
  object->number = 7;
  const lot::ShmWeakPtr<Virtual> weak = object;
  const lot::ShmWeakPtr<Base> base = weak;
  REQUIRE(base.lock());
  CHECK(base.lock()->number == 7);
  const void* const address = object.get();
  object.reset();
  std::vector<Shared> more;  // pointers into nowhere lie where the object's table was
  while (more.empty() || more.back().get() != address) {
    REQUIRE(more.size() < 1000);
    more.push_back(place.make(0x4141414141414141));
  }
  const lot::ShmWeakPtr<Base> dead = weak;
  CHECK(dead.expired());
  CHECK(dead.lock() == nullptr);
  CHECK(same_owner(dead, base));
  CHECK(same_owner(dead, weak));
  CHECK_FALSE(same_owner(dead, more.back()));
}

TEST_CASE("a weak pointer of a process that has left has expired, though the message lives") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined, end;
  Child maker([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Pair>("/t");
    const Shared s = pusher.loan(std::uint64_t{1}, std::uint64_t{2});
    must(pusher.wait_for_readers(1, 20s), "a reader");
    must_go(pusher.push(s));
    must(end.next() == '.', "the end");
    must(s->a == 1, "the message lives");
  });
  lot::ShmWeakPtr<const Pair> seen;
  {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Pair>("/t");
    const auto message = puller.pull(20s);
    REQUIRE(message);
    seen = message;
    CHECK(!seen.expired());
  }
  CHECK(seen.expired());
  CHECK(seen.lock() == nullptr);
  CHECK(seen.use_count() == 0);
  {
    const lot::ShmEngine again(options);  // another membership
    CHECK(seen.expired());
    CHECK(seen.lock() == nullptr);
  }
  end.tell();
  CHECK(maker.wait() == 0);
}

TEST_CASE("a message is not alone because the one before it in its block was handed over") {
  const Watchdog watchdog(60);
  lot::EngineOptions options = fresh();
  options.blocks = 16;
  Steps has, go;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto pairs = engine.subscribe<Pair>("pairs");
    auto tasks = engine.queue<Unique>("tasks");
    has.tell();
    tasks.wait_and_pop().reset();
    has.tell();
    const Const pair = pairs.pull(60s);
    has.tell(pair.unique() ? 'u' : 's');
    go.next();
  });
  REQUIRE(has.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto tasks = engine.queue<Unique>("tasks");
    auto out = engine.advertise<Pair>("pairs");
    Unique task = tasks.make(Pair{1, 2});
    const Pair* const place = task.get();
    REQUIRE(tasks.put(std::move(task)) == lot::Status::Ok);
    REQUIRE(has.next() == '.');
    std::vector<Unique> others;
    for (task = tasks.make(Pair{3, 4}); task.get() != place; task = tasks.make(Pair{3, 4})) {
      others.push_back(std::move(task));
    }
    const Shared pair(std::move(task));
    REQUIRE(out.push(pair) == lot::Status::Ok);
    CHECK(has.next() == 's');
  }
  go.tell();
  CHECK(reader.wait() == 0);
}

TEST_SUITE_END();
