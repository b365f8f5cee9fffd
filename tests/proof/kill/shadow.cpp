// SPDX-License-Identifier: Apache-2.0
#include "shadow.hpp"

#include <algorithm>
#include <cstring>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "description/wire.hpp"

namespace lot::kill {

using segment::kGranule;

Shadow::Shadow(const EngineOptions& options)
    : path_(options.directory + "/" + options.segment), capacity_{options.size_bytes,
                                                                  options.processes + 1,
                                                                  options.blocks,
                                                                  options.topics,
                                                                  options.channels,
                                                                  options.readers} {
  look_for_file();
}

Shadow::~Shadow() { unmap(); }

void Shadow::unmap() {
  if (now_ != nullptr) munmap(const_cast<unsigned char*>(now_), size_);
  now_ = nullptr;
}

void Shadow::look_for_file() {
  struct stat status {};
  std::string name = path_;
  if (stat(name.c_str(), &status) != 0) {
    name += ".new";
    if (stat(name.c_str(), &status) != 0) return;  // what is unlinked stays mapped
  }
  const auto size = static_cast<std::uint64_t>(status.st_size);
  if (now_ != nullptr && status.st_dev == device_ && status.st_ino == inode_ && size == size_) {
    return;
  }
  unmap();
  size_ = size;
  device_ = status.st_dev;
  inode_ = status.st_ino;
  before_.clear();
  described_ = 0;
  ever_owned_.clear();
  watched_.clear();
  capacity_.size = size;
  geometry_ = segment::Geometry::of(capacity_);
  if (size < geometry_.data) return;
  const int fd = open(name.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd == -1) return;
  void* memory = mmap(nullptr, size, PROT_READ, MAP_SHARED, fd, 0);
  close(fd);
  if (memory == MAP_FAILED) return;
  now_ = static_cast<const unsigned char*>(memory);
  before_.assign(now_, now_ + size);
  ever_owned_.resize(geometry_.granules);
  watch();
}

std::uint32_t Shadow::tag(const unsigned char* bytes, std::uint64_t granule) const {
  std::uint32_t value = 0;
  std::memcpy(&value, bytes + geometry_.tags + granule * sizeof(value), sizeof(value));
  return value;
}

bool Shadow::compare(std::uint64_t begin, std::uint64_t bytes) {
  if (std::memcmp(now_ + begin, before_.data() + begin, bytes) == 0) return false;
  std::memcpy(before_.data() + begin, now_ + begin, bytes);
  return true;
}

void Shadow::watch() {
  for (std::uint64_t g = 0; g < geometry_.granules; ++g) {
    if (ever_owned_[g] || tag(now_, g) == 0) continue;
    ever_owned_[g] = true;
    watched_.push_back(g);
  }
}

std::uint64_t Shadow::end_of_descriptions() const {
  const auto* topics = reinterpret_cast<const segment::TopicEntry*>(now_ + geometry_.topics);
  std::uint64_t end = 0;
  for (std::uint32_t i = 0; i < capacity_.topics; ++i) {
    const std::uint64_t word = topics[i].description.load(std::memory_order_relaxed);
    end = std::max(end, segment::description_offset(word) + segment::description_bytes(word));
  }
  return std::min(end + segment::kDescriptionPiece + description::kMostBytes,
                  segment::kDescriptionsBytes);
}

bool Shadow::changed() {
  if (now_ == nullptr) return false;
  described_ = std::max(described_, end_of_descriptions());
  const std::uint64_t tags = geometry_.granules * sizeof(std::uint32_t);
  if (std::memcmp(now_ + geometry_.tags, before_.data() + geometry_.tags, tags) != 0) watch();
  const std::uint64_t behind = geometry_.descriptions + segment::kDescriptionsBytes;
  bool any = compare(0, geometry_.descriptions + described_);
  any |= compare(behind, geometry_.data - behind);
  for (const std::uint64_t g : watched_) any |= compare(geometry_.data + g * kGranule, kGranule);
  return any;
}

std::size_t Shadow::stray() {
  std::size_t n = 0;
  if (now_ == nullptr) return n;
  n += compare(geometry_.descriptions + described_, segment::kDescriptionsBytes - described_);
  for (std::uint64_t g = 0; g < geometry_.granules; ++g) {
    n += !ever_owned_[g] && compare(geometry_.data + g * kGranule, kGranule);
  }
  return n;
}

}  // namespace lot::kill
