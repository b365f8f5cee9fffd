// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <fcntl.h>
#include <pthread.h>
#include <string>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "sockets.hpp"
#include "transport.hpp"

/// TZC's protocol, as published, written anew: partial serialisation.
///
/// The bytes of a message lie in shared memory, one segment a topic; its descriptor goes over TCP.
/// Publishers take memory under the segment's mutex from a linked list of messages, the first one
/// that nobody refers to. A subscriber that comes too late finds another generation there and drops
/// the descriptor; nobody waits for it. References are taken by one compare-and-swap, only while
/// there are some and the generation is right, so a message cannot go away in between.
///
/// All messages of a stream have one size, so the list holds all of the memory from the beginning
/// on, as if it had just run out.
///
/// Crash: a publisher that is killed with the mutex leaves it locked for ever, a subscriber that is
/// killed in its callback leaves a reference, and that memory is lost. All files lie in the
/// stream's directory, which goes as a whole; so nobody counts the processes that are attached.
namespace ab::tzc {

inline constexpr std::size_t kLine = 64;
inline constexpr std::size_t kPage = 4096;
inline constexpr std::uint32_t kNone = UINT32_MAX;

/// What goes over a connection for a message.
struct Notice {
  std::uint64_t number;      ///< the publisher's count: gaps are what did not fit into the socket
  std::uint64_t generation;  ///< the magic number
  std::uint64_t length;
  std::uint32_t handle;
  std::uint32_t publisher;
};
static_assert(sizeof(Notice) == 32);

/// A message's place in the segment.
struct alignas(kLine) Node {
  /// Generation << 16 | references, of which one is the list's own: 0 means that a publisher is
  /// about to give it another generation. Publishers and subscribers change it by read-modify-write
  /// alone, in acquire-release order: what is written for one generation is read under it, and what
  /// was read is read before the next is written.
  std::atomic<std::uint64_t> state;
  std::uint32_t next;  ///< in the list; under the mutex
  std::uint32_t previous;
};
inline constexpr unsigned kReferenceBits = 16;
inline constexpr std::uint64_t kReferences = (std::uint64_t{1} << kReferenceBits) - 1;

struct Head {
  alignas(kLine) pthread_mutex_t mutex;
  std::uint32_t first;  ///< the oldest; under the mutex
  std::uint32_t last;
};

/// The topic's segment: a head, the nodes, and their bytes, each at a page.
class Segment {
 public:
  explicit Segment(const Stream& stream)
      // What waits for a slow subscriber, what each one reads, and what publishers fill.
      : nodes_(stream.publishers * (stream.depth + stream.subscribers + 2)),
        stride_((stream.size + kPage - 1) / kPage * kPage),
        bytes_at_((sizeof(Head) + nodes_ * sizeof(Node) + kPage - 1) / kPage * kPage),
        length_(bytes_at_ + nodes_ * stride_) {
    const std::string path = stream.directory + "/" + stream.name + "-tzc";
    const Descriptor file(open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    // Who comes first makes it; the kernel unlocks for the dead.
    if (!file || flock(file.get(), LOCK_EX) != 0) fail(path);
    struct stat status {};
    if (fstat(file.get(), &status) != 0) fail(path);
    const bool is_new = static_cast<std::size_t>(status.st_size) != length_;
    if (is_new && ftruncate(file.get(), static_cast<off_t>(length_)) != 0) fail(path);
    void* const at =
        mmap(nullptr, length_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, file.get(), 0);
    if (at == MAP_FAILED) fail(path);
    base_ = static_cast<std::byte*>(at);
    if (is_new) initialise();
    flock(file.get(), LOCK_UN);  // the mapping keeps the open file, and the lock with it
  }
  ~Segment() { munmap(base_, length_); }
  Segment(const Segment&) = delete;
  Segment& operator=(const Segment&) = delete;

  std::byte* bytes(std::uint32_t handle) const { return base_ + bytes_at_ + handle * stride_; }
  Node& node(std::uint32_t handle) const {
    return reinterpret_cast<Node*>(base_ + sizeof(Head))[handle];
  }
  std::uint32_t size() const { return nodes_; }

  /// Frees the first message that nobody refers to and makes it the last one, of a new generation,
  /// with a reference for the caller. kNone: subscribers have them all.
  std::uint32_t allocate() {
    pthread_mutex_lock(&head().mutex);
    std::uint32_t handle = head().first;
    while (handle != kNone && !end(node(handle))) handle = node(handle).next;
    if (handle != kNone) {
      unlink(handle);
      append(handle);
      Node& mine = node(handle);
      const std::uint64_t generation =
          (mine.state.load(std::memory_order_relaxed) >> kReferenceBits) + 1;
      mine.state.store(generation << kReferenceBits | 2, std::memory_order_release);
    }
    pthread_mutex_unlock(&head().mutex);
    return handle;
  }
  std::uint64_t generation(std::uint32_t handle) const {
    return node(handle).state.load(std::memory_order_relaxed) >> kReferenceBits;
  }
  /// A reference, if this generation is still there.
  bool acquire(std::uint32_t handle, std::uint64_t generation) const {
    std::uint64_t state = node(handle).state.load(std::memory_order_relaxed);
    do {
      if (state >> kReferenceBits != generation || (state & kReferences) == 0) return false;
    } while (!node(handle).state.compare_exchange_weak(state, state + 1, std::memory_order_acq_rel,
                                                       std::memory_order_relaxed));
    return true;
  }
  void release(std::uint32_t handle) const {
    node(handle).state.fetch_sub(1, std::memory_order_acq_rel);
  }

 private:
  Head& head() const { return *reinterpret_cast<Head*>(base_); }

  void initialise() {
    pthread_mutexattr_t attributes;
    pthread_mutexattr_init(&attributes);
    pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
    pthread_mutex_init(&head().mutex, &attributes);
    pthread_mutexattr_destroy(&attributes);
    head().first = head().last = kNone;
    for (std::uint32_t handle = 0; handle < nodes_; ++handle) {
      node(handle).state.store(1, std::memory_order_relaxed);
      append(handle);
    }
  }
  static bool end(Node& node) {
    std::uint64_t state = node.state.load(std::memory_order_relaxed);
    return (state & kReferences) == 1 &&
           node.state.compare_exchange_strong(state, state - 1, std::memory_order_acq_rel,
                                              std::memory_order_relaxed);
  }
  void unlink(std::uint32_t handle) {
    const Node& gone = node(handle);
    (gone.previous == kNone ? head().first : node(gone.previous).next) = gone.next;
    (gone.next == kNone ? head().last : node(gone.next).previous) = gone.previous;
  }
  void append(std::uint32_t handle) {
    Node& last = node(handle);
    last.next = kNone;
    last.previous = head().last;
    (head().last == kNone ? head().first : node(head().last).next) = handle;
    head().last = handle;
  }

  const std::uint32_t nodes_;
  const std::size_t stride_;
  const std::size_t bytes_at_;
  const std::size_t length_;
  std::byte* base_ = nullptr;
};

}  // namespace ab::tzc
