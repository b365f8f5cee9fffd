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

[[noreturn]] void refuse_unknown() {
  throw Error(EINVAL, "message", "it lies in no segment that this copy of the library has joined",
              "join its segment by a lot::ShmEngine first");
}

}  // namespace

ControlCell* cell_of(const void* reference, bool in_message, std::uint32_t block,
                     const void* target, std::size_t bytes) {
  transport::Participant* p = transport::Participant::at(reference);
  if (p == nullptr) {
    if (in_message) refuse_unknown();
    return nullptr;
  }
  const std::uint64_t offset = p->segment().offset_of(target);
  if (block >= p->blocks() || offset > p->segment().size() ||
      bytes > p->segment().size() - offset) {
    throw Error(EBADMSG, p->segment().path(), "a reference in a message is damaged",
                "somebody has written into the segment who should not");
  }
  return &p->holder().cell(block);
}

ControlCell* acquire_block(ControlCell* cell) {
  cell->hub->acquire(cell);
  return cell;
}

ControlCell* refer(Arena& arena, ControlCell* target) {
  transport::Participant* const at = transport::Participant::at(&arena);
  if (at == nullptr) refuse_unknown();
  transport::Participant& p = *at;
  if (!p.same_segment(*target)) {
    throw Error(EINVAL, p.segment().path(), "a message can not refer to one in another segment",
                "copy it, or put both topics into one segment");
  }
  if (target->hub != p.hub()) {  // it knows the target by an address of another mapping
    throw Error(
        EINVAL, p.segment().path(),
        "a message can not refer to one that another copy of the library has pulled or made",
        "pull it by the copy that makes the message");
  }
  // The hold would be ours, and its entry the home's.
  if (!p.holder().is_home(arena.block)) {
    throw Error(EPERM, p.segment().path(),
                "a message that was received can not refer to others than it does",
                "make one of your own that refers to both");
  }
  if (arena.is_frozen()) {
    throw Error(EPERM, p.segment().path(),
                "a message that was published can not refer to others than it does",
                "build it wholly before push(), or copy it into a new loan()");
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
