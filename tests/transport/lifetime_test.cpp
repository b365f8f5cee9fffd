// SPDX-License-Identifier: Apache-2.0

// When a participant leaves, and when it is destroyed: for an owner that only counts.

#include "transport/lifetime.hpp"

#include <atomic>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

namespace {

/// Has pointers as it is told to.
struct Owner final : lot::transport::Lifetime::Owner {
  bool holds_pointers() noexcept override { return pointers != 0; }
  void leave() noexcept override { ++left; }
  void end() noexcept override { ++ended; }

  std::atomic<int> pointers{0};
  std::atomic<int> left{0};
  std::atomic<int> ended{0};
  lot::transport::Lifetime lifetime{*this};

  /// The last handle goes.
  void close() {
    lifetime.enter();
    lifetime.close();
    lifetime.exit();
  }
  /// A pointer goes.
  void drop() {
    lifetime.enter();
    --pointers;
    lifetime.exit();
  }
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("an owner without pointers leaves and ends when its last handle goes, and not before") {
  Owner owner;
  owner.lifetime.enter();
  owner.lifetime.exit();
  CHECK(owner.left == 0);
  owner.close();
  CHECK(owner.left == 1);
  CHECK(owner.ended == 1);
}

TEST_CASE("the last pointer makes an owner leave whose handles have gone") {
  Owner owner;
  owner.pointers = 2;
  owner.close();
  owner.drop();
  CHECK(owner.left == 0);
  CHECK(!owner.lifetime.has_left());
  owner.drop();
  CHECK(owner.left == 1);
  CHECK(owner.ended == 1);
}

TEST_CASE("a weak pointer keeps an owner that has left, until it goes") {
  Owner owner;
  owner.lifetime.add_reference();
  owner.close();
  CHECK(owner.left == 1);
  CHECK(owner.lifetime.has_left());
  CHECK(owner.ended == 0);
  owner.lifetime.drop_reference();
  CHECK(owner.ended == 1);
}

TEST_CASE("of threads that drop the last pointers at once, one makes the owner leave") {
  for (int round = 0; round < 200; ++round) {
    Owner owner;
    owner.pointers = 4;
    owner.lifetime.add_reference();  // so that the threads may look at it to their ends
    owner.close();
    std::vector<std::thread> threads;
    for (int i = 0; i < 4; ++i) threads.emplace_back([&] { owner.drop(); });
    for (auto& thread : threads) thread.join();
    CHECK(owner.left == 1);
    CHECK(owner.ended == 0);
    owner.lifetime.drop_reference();
    CHECK(owner.ended == 1);
  }
}
