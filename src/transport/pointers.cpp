// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <cstdlib>
#include <memory>

#include <cxxabi.h>

#include "lot/detail/core.hpp"
#include "lot/type_identity.hpp"

#include "transport/participant.hpp"

namespace lot::detail {

std::string demangle(const char* name) {
  int status = 0;
  const std::unique_ptr<char, void (*)(void*)> text(
      abi::__cxa_demangle(name, nullptr, nullptr, &status), &std::free);
  return status == 0 ? text.get() : name;
}

namespace {

transport::Participant& participant_at(const void* inside) {
  transport::Participant* p = transport::Participant::at(inside);
  if (p == nullptr) {
    throw Error(EINVAL, "message", "it lies in no segment that this copy of the library has joined",
                "join its segment by a lot::ShmEngine first");
  }
  return *p;
}

}  // namespace

ControlCell* cell_of(const void* inside, std::uint32_t block) {
  transport::Participant& p = participant_at(inside);
  if (block >= p.blocks()) {
    throw Error(EINVAL, p.segment().path(), "a reference in a message is damaged", "");
  }
  return &p.holder().cell(block);
}

ControlCell* acquire_block(ControlCell* cell) {
  cell->hub->acquire(cell);
  return cell;
}

ControlCell* refer(Arena& arena, ControlCell* target) {
  transport::Participant& p = participant_at(&arena);
  if (!p.same_segment(*target)) {
    throw Error(EINVAL, p.segment().path(), "a message can not refer to one in another segment",
                "copy it, or put both topics into one segment");
  }
  ControlCell* cell = &p.holder().cell(target->block);
  bool known = false;
  p.holder().each_reference(arena.block, [&](std::uint32_t b) { known |= b == cell->block; });
  if (known) return cell;
  ReferenceList* list = nullptr;
  if (arena.references != 0)
    list = reinterpret_cast<ReferenceList*>(arena.base() + arena.references);
  if (list == nullptr || list->count == ReferenceList::kEntries) {
    auto* fresh = static_cast<ReferenceList*>(arena.allocate(sizeof(ReferenceList), 8));
    fresh->next = arena.references;
    fresh->count = 0;
    arena.references =
        static_cast<std::uint64_t>(reinterpret_cast<unsigned char*>(fresh) - arena.base());
    list = fresh;
  }
  // The hold first, then its entry: killed in between, the hold goes with our bit.
  p.holder().acquire(cell->block, hold::kRing);
  list->block[list->count] = cell->block;
  ++list->count;
  return cell;
}

}  // namespace lot::detail
