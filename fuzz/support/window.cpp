// SPDX-License-Identifier: Apache-2.0
#include "support/window.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "robust_mutex/robust_mutex.hpp"
#include "segment/segment.hpp"

#if defined(__SANITIZE_ADDRESS__)
#define LOT_FUZZ_ASAN 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define LOT_FUZZ_ASAN 1
#endif
#endif

#ifdef LOT_FUZZ_ASAN
#include <sanitizer/asan_interface.h>
#else
#define ASAN_POISON_MEMORY_REGION(address, bytes) (static_cast<void>(0))
#define ASAN_UNPOISON_MEMORY_REGION(address, bytes) (static_cast<void>(0))
#endif

namespace lot::fuzz::window {
namespace {

constexpr std::size_t kGuard = std::size_t{1}
                               << 40;  ///< what 32-bit indexes of 256 bytes can reach
constexpr std::size_t kMost = std::size_t{1} << 30;

struct Mapped {
  unsigned char* base = nullptr;
  std::size_t size = 0;
};
Mapped mapped;
bool installed = false;

/// System calls, since AddressSanitizer's mmap would clear the shadow of all this.
unsigned char* map(void* at, std::size_t bytes, int protection, int flags, int fd) {
  const long address = syscall(SYS_mmap, at, bytes, protection, flags, fd, off_t{0});
  if (address == -1) {
    std::perror("lot: fuzz: mmap");
    std::abort();
  }
  return reinterpret_cast<unsigned char*>(address);
}

constexpr int kNothing = MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE;

/// Where segments lie: at a multiple of a unit, so that the library need not move there.
unsigned char* place() {
  static unsigned char* const reserved = map(nullptr, 2 * kGuard + kMost, PROT_NONE, kNothing, -1);
  const auto at = reinterpret_cast<std::uintptr_t>(reserved) + kGuard;
  return reserved + kGuard + (segment::kUnit - at % segment::kUnit);
}

/// Calls f(address, bytes, free) for all of the segment: the tables, then runs of granules.
template <class F>
void each_part(F&& f) {
  const auto& header = *reinterpret_cast<const segment::Header*>(mapped.base);
  const auto geometry = segment::Geometry::of(header.capacity);
  const auto* tags = reinterpret_cast<const segment::Tag*>(mapped.base + geometry.tags);
  const auto is_free = [&](std::uint64_t i) {
    return tags[i].load(std::memory_order_relaxed) == 0;
  };
  f(mapped.base, geometry.data, false);
  for (std::uint64_t i = 0, end = 0; i < geometry.granules; i = end) {
    const bool free = is_free(i);  // asked once: a warden gives granules back meanwhile
    for (end = i + 1; end < geometry.granules && is_free(end) == free;) ++end;
    f(mapped.base + geometry.data + i * segment::kGranule, (end - i) * segment::kGranule, free);
  }
}

}  // namespace

void install() { installed = true; }

unsigned char* base() { return mapped.base; }
std::size_t size() { return mapped.size; }

void poison_free_granules() {
  if (mapped.base == nullptr) return;
  each_part([](unsigned char* address, std::size_t bytes, bool free) {
    static_cast<void>(address);
    static_cast<void>(bytes);
    if (free) {
      ASAN_POISON_MEMORY_REGION(address, bytes);
    } else {
      ASAN_UNPOISON_MEMORY_REGION(address, bytes);
    }
  });
}

bool is_usable(const void* address, std::size_t bytes) {
  const auto* from = static_cast<const unsigned char*>(address);
  if (from < mapped.base || from > mapped.base + mapped.size ||
      bytes > static_cast<std::size_t>(mapped.base + mapped.size - from)) {
    return false;
  }
  bool usable = true;
  each_part([&](const unsigned char* part, std::size_t size_of_part, bool free) {
    if (free && part < from + bytes && from < part + size_of_part) usable = false;
  });
  return usable;
}

}  // namespace lot::fuzz::window

// ---- what the library calls
// -------------------------------------------------------------------------

namespace window = lot::fuzz::window;

extern "C" {
void* __real_mmap(void*, std::size_t, int, int, int, off_t);
int __real_munmap(void*, std::size_t);
std::uint32_t __real__ZN3lot7segment7Segment9claim_runEjj(lot::segment::Segment*, unsigned,
                                                          std::uint32_t);
bool __real__ZN3lot7segment7Segment10extend_runEjjj(lot::segment::Segment*, std::uint32_t,
                                                    std::uint32_t, std::uint32_t);

void* __wrap_mmap(void* at, std::size_t bytes, int protection, int flags, int fd, off_t offset) {
  if (!window::installed || window::mapped.base != nullptr || bytes > window::kMost) {
    return __real_mmap(at, bytes, protection, flags, fd, offset);
  }
  // The room that the library asks for before it maps the file there.
  if (at == nullptr && protection == PROT_NONE && flags == window::kNothing) {
    return window::place();
  }
  if ((flags & MAP_SHARED) == 0 || (at != nullptr && at != window::place())) {
    return __real_mmap(at, bytes, protection, flags, fd, offset);
  }
  window::mapped = {window::map(window::place(), bytes, protection, flags | MAP_FIXED, fd), bytes};
  window::poison_free_granules();
  return window::mapped.base;
}

int __wrap_munmap(void* at, std::size_t bytes) {
  if (!window::installed || at == nullptr) return __real_munmap(at, bytes);
  // The rest of the room, or all of it where the file could not be mapped, stays closed.
  const bool is_rest = at == window::mapped.base + window::mapped.size;
  if (at != window::mapped.base && (is_rest || at == window::place())) return 0;
  if (at != window::mapped.base) return __real_munmap(at, bytes);
  ASAN_UNPOISON_MEMORY_REGION(window::mapped.base, window::mapped.size);
  window::mapped = {};
  window::map(at, bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE | MAP_FIXED, -1);
  return 0;
}

std::uint32_t __wrap__ZN3lot7segment7Segment9claim_runEjj(lot::segment::Segment* segment,
                                                          std::uint32_t granules,
                                                          std::uint32_t tag) {
  const std::uint32_t run = __real__ZN3lot7segment7Segment9claim_runEjj(segment, granules, tag);
  if (run != lot::segment::Granules<lot::segment::Atomics>::kNone) {
    ASAN_UNPOISON_MEMORY_REGION(segment->base() + segment->granule_offset(run),
                                lot::segment::kGranule * granules);
  }
  return run;
}

bool __wrap__ZN3lot7segment7Segment10extend_runEjjj(lot::segment::Segment* segment,
                                                    std::uint32_t end, std::uint32_t granules,
                                                    std::uint32_t tag) {
  if (!__real__ZN3lot7segment7Segment10extend_runEjjj(segment, end, granules, tag)) return false;
  ASAN_UNPOISON_MEMORY_REGION(segment->base() + segment->granule_offset(end),
                              lot::segment::kGranule * granules);
  return true;
}
}  // extern "C"

// A function that returns what extern "C" cannot.
lot::RobustMutex::Outcome really_lock(lot::RobustMutex*, std::chrono::nanoseconds) asm(
    "__real__ZN3lot11RobustMutex8lock_forENSt6chrono8durationIlSt5ratioILl1ELl1000000000EEEE");
lot::RobustMutex::Outcome lock_soon(lot::RobustMutex*, std::chrono::nanoseconds) asm(
    "__wrap__ZN3lot11RobustMutex8lock_forENSt6chrono8durationIlSt5ratioILl1ELl1000000000EEEE");

lot::RobustMutex::Outcome lock_soon(lot::RobustMutex* mutex, std::chrono::nanoseconds timeout) {
  return really_lock(mutex,
                     std::min<std::chrono::nanoseconds>(timeout, std::chrono::milliseconds(2)));
}
