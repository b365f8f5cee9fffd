// SPDX-License-Identifier: Apache-2.0
#include "gateway/ledger.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <fcntl.h>
#include <random>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

namespace lot::gateway {
namespace {

constexpr std::size_t kMostEntries = 512;
constexpr std::uint64_t kMagic = 0x314c475f544f4cULL;  // "LOT_GL1"

[[noreturn]] void fail(const std::string& file, const char* what) {
  throw Error(errno, file, what, "");
}

[[noreturn]] void refuse(const std::string& file) {
  throw Error(EEXIST, file, "it is not the file of a gateway's progress",
              "name a file that is not there yet");
}

std::uint64_t random_id() {
  std::random_device random;
  return std::uint64_t{random()} << 32 | random() | 1;
}

}  // namespace

struct Ledger::File {
  std::uint64_t magic;
  std::uint64_t place;  ///< a hash of it
  std::uint64_t id;
  std::array<Entry, kMostEntries> entries;
};

// ---- progress ----

std::uint64_t Progress::next_of(std::uint64_t id) const noexcept {
  const auto found = std::ranges::find(lines, id, &Line::id);
  return found == lines.end() ? 0 : found->next;
}

void Progress::set_next(std::uint64_t id, std::uint64_t next) noexcept {
  const auto found = std::ranges::find(lines, id, &Line::id);
  const auto its = found == lines.end() ? lines.end() - 1 : found;
  std::rotate(lines.begin(), its, its + 1);
  lines.front() = {id, next};
}

// ---- the file ----

Ledger::Ledger(const std::string& file, std::string_view place) {
  constexpr mode_t kOwnersOnly = 0600;
  const auto opened = [&] {
    const int fd = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, kOwnersOnly);
    if (fd < 0) fail(file, "the file of the gateway's progress can not be opened");
    return mcap::Descriptor(fd);
  };
  lock_ = opened();
  if (flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
    throw Error(EBUSY, file, "another gateway has this file", "give each gateway its own");
  }
  // Another descriptor: a mapping of the one that is locked would hold the lock.
  const mcap::Descriptor mapped = opened();
  struct stat its {};
  if (fstat(mapped.get(), &its) != 0) fail(file, "it can not be looked at");
  if (its.st_size != 0 && std::cmp_not_equal(its.st_size, sizeof(File))) refuse(file);
  // Room on the disk now: a store to a mapped page that finds none later would end the process.
  errno = posix_fallocate(mapped.get(), 0, sizeof(File));
  if (errno != 0) fail(file, "it can not be made so large");
  void* const at = mmap(nullptr, sizeof(File), PROT_READ | PROT_WRITE, MAP_SHARED, mapped.get(), 0);
  if (at == MAP_FAILED) fail(file, "it can not be mapped");
  file_ = static_cast<File*>(at);
  if (file_->magic != kMagic && file_->magic != 0) {
    munmap(at, sizeof(File));
    refuse(file);
  }
  const std::uint64_t hash = std::hash<std::string_view>()(place);
  if (file_->magic == kMagic && file_->place == hash) return;
  std::memset(static_cast<void*>(file_), 0, sizeof(File));
  file_->place = hash;
  file_->id = random_id();
  // Release: killed before it, the next gateway makes the file anew.
  std::atomic_ref(file_->magic).store(kMagic, std::memory_order_release);
}

Ledger::~Ledger() { munmap(file_, sizeof(File)); }

std::uint64_t Ledger::id() const noexcept { return file_->id; }

Ledger::Entry* Ledger::entry(Way way, std::string_view topic) noexcept {
  if (topic.size() >= Entry::kMostTopic) return nullptr;
  for (Entry& entry : file_->entries) {
    if (entry.way_ == 0) {
      std::ranges::copy(topic, entry.topic_.begin());
      entry.way_ = static_cast<char>(way);
    }
    if (entry.way_ == static_cast<char>(way) && entry.topic() == topic) return &entry;
  }
  return nullptr;
}

void Ledger::for_each(
    const std::function<void(Way, std::string_view topic, const Progress&)>& see) const {
  for (const Entry& entry : file_->entries) {
    if (entry.way_ == 0) return;
    see(Way{entry.way_}, entry.topic(), entry.told());
  }
}

Progress Ledger::Entry::told() const noexcept { return both_[current_ % 2]; }

void Ledger::Entry::write(const Progress& progress) noexcept {
  const std::uint64_t next = (current_ + 1) % 2;
  both_[next] = progress;
  // Release: a gateway that comes after a kill finds what this one names. Killed before it: the
  // other one counts.
  std::atomic_ref(current_).store(next, std::memory_order_release);
}

}  // namespace lot::gateway
