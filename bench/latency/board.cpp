// SPDX-License-Identifier: Apache-2.0
#include "board.hpp"

#include <climits>
#include <cstring>
#include <ctime>
#include <linux/futex.h>
#include <stdexcept>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "throw_errno.hpp"

namespace ab {
namespace {

constexpr std::size_t kPage = 4096;
constexpr std::size_t pages(std::size_t bytes) { return (bytes + kPage - 1) / kPage * kPage; }
constexpr std::size_t kArmsAt = pages(sizeof(Head));
constexpr std::size_t kEach = 256;  // no two records share a line
static_assert(sizeof(ArmRecord) <= kEach);
constexpr std::size_t kNode = pages(sizeof(NodeRecord));

}  // namespace

void Gate::set(std::uint32_t value) {
  value_.store(value, std::memory_order_release);
  syscall(SYS_futex, &value_, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
}

void Gate::add(std::uint32_t n) {
  value_.fetch_add(n, std::memory_order_acq_rel);
  syscall(SYS_futex, &value_, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
}

std::uint32_t Gate::wait_while(std::uint32_t seen, std::chrono::nanoseconds patience) const {
  const timespec limit{static_cast<time_t>(patience.count() / 1'000'000'000),
                       static_cast<long>(patience.count() % 1'000'000'000)};
  syscall(SYS_futex, &value_, FUTEX_WAIT, seen, &limit, nullptr, 0);
  return load();
}

Board::Board(std::size_t arms, std::size_t nodes, std::size_t bytes)
    : fd_(memfd_create("lot_ab", 0)) {  // inherited: no CLOEXEC
  if (fd_ < 0) throw_errno("memfd_create");
  const std::size_t free_at = kArmsAt + pages(arms * kEach) + nodes * kNode;
  const std::size_t size = pages(free_at + bytes);
  if (ftruncate(fd_, static_cast<off_t>(size)) != 0) {
    close(fd_);
    throw_errno("ftruncate");
  }
  map(size);
  head().arms = static_cast<std::uint32_t>(arms);
  head().nodes = static_cast<std::uint32_t>(nodes);
  head().free_at = free_at;
}

Board::Board(int fd) : fd_(fd) {
  struct stat s {};
  if (fstat(fd, &s) != 0) throw_errno("the board of lot_ab");
  map(static_cast<std::size_t>(s.st_size));
}

void Board::map(std::size_t size) {
  void* const at = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd_, 0);
  if (at == MAP_FAILED) {
    close(fd_);
    throw_errno("mmap");
  }
  base_ = static_cast<std::byte*>(at);
  size_ = size;
}

Board::~Board() {
  munmap(base_, size_);
  close(fd_);
}

ArmRecord& Board::arm(std::size_t i) const {
  return *reinterpret_cast<ArmRecord*>(base_ + kArmsAt + i * kEach);
}

NodeRecord& Board::node(std::size_t i) const {
  return *reinterpret_cast<NodeRecord*>(base_ + kArmsAt + pages(head().arms * kEach) + i * kNode);
}

Sample* Board::samples(const NodeRecord& node) const {
  return reinterpret_cast<Sample*>(base_ + node.samples_at);
}

char* Board::profile(const NodeRecord& node) const {
  return reinterpret_cast<char*>(base_ + node.profile_at);
}

std::string Board::plan() const {
  return {reinterpret_cast<const char*>(base_ + head().plan_at), head().plan_size};
}

void Board::set_plan(const std::string& text) {
  head().plan_at = give(text.size());
  std::memcpy(base_ + head().plan_at, text.data(), text.size());
  head().plan_size = text.size();
}

std::uint64_t Board::give(std::size_t bytes) {
  const std::uint64_t at = head().free_at;
  if (size_ - at < pages(bytes)) throw std::length_error("the board of lot_ab is too small");
  head().free_at += pages(bytes);
  return at;
}

}  // namespace ab
