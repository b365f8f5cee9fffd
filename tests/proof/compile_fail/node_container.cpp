// SPDX-License-Identifier: Apache-2.0

#include <list>
#include <memory>

#include <lot/compliance.hpp>

// Stands for an allocator in shared memory.
template <typename T>
struct Allocator : std::allocator<T> {
  template <typename U>
  struct rebind {
    using other = Allocator<U>;
  };
};
template <typename T>
struct lot::is_shm_allocator<Allocator<T>> : std::true_type {};

struct Message {
  int stamp;
  std::list<int, Allocator<int>> items;
};

static_assert(lot::assert_message<Message>());
