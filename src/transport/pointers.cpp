// SPDX-License-Identifier: Apache-2.0
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <memory>
#include <string>

#include <cxxabi.h>

#include "lot/detail/core.hpp"
#include "lot/detail/described.hpp"
#include "lot/detail/type_name.hpp"

#include "description/wire.hpp"
#include "transport/participant.hpp"

namespace lot::detail {

std::string demangle(const char* name) {
  int status = 0;
  const std::unique_ptr<char, void (*)(void*)> text(
      abi::__cxa_demangle(name, nullptr, nullptr, &status), &std::free);
  return status == 0 ? text.get() : name;
}

std::string demangle_argument(const char* bearer) {
  const std::string whole = demangle(bearer);  // lot::detail::NameOf<T>::bearer
  const std::size_t begin = whole.find('<') + 1;
  std::size_t end = whole.rfind(">::bearer");
  if (end == std::string::npos) return whole;
  if (whole[end - 1] == ' ') --end;  // "> >"
  return whole.substr(begin, end - begin);
}

namespace {

[[noreturn]] void refuse_unknown() {
  throw Error(EINVAL, "message", "it lies in no segment that this copy of the library has joined",
              "join its segment by a lot::ShmEngine first");
}

}  // namespace

ControlBlock* control_of(const void* reference, bool in_message, std::uint32_t block,
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
  return &p->holder().control(block);
}

ControlBlock* acquire_block(ControlBlock* control) {
  control->hub->acquire(control);
  return control;
}

bool is_same(const MessageType& a, const MessageType& b) {
  // A topic keeps the begin of a long name.
  const auto name = [](const MessageType& type) {
    return std::string_view(type.name).substr(0, segment::kTypeNameBytes - 1);
  };
  if (a.size != b.size || a.align != b.align || a.hash != b.hash || name(a) != name(b) ||
      (a.described == nullptr) != (b.described == nullptr)) {
    return false;
  }
  if (a.described == nullptr) return true;
  const Described& there = a.described(a);
  const Described& here = b.described(b);
  if (there.layout != here.layout) return false;
  if (there.names != 0 && here.names != 0) return there.names == here.names;
  return !there.has_names || !here.has_names ||
         !description::compare_names(there.bytes, here.bytes).differ;
}

void require_type(const ControlBlock& control, const MessageType& type) {
  if (is_same(*control.type, type)) return;
  throw Error(EINVAL, control.hub->path(&control),
              std::string("the pointer that was pushed points to a message of another type (") +
                  control.type->name + "); readers get whole messages of type " + type.name,
              "push it as what it was made, or copy the object into a loan()");
}

std::uint32_t refer(Arena& arena, ControlBlock* target, const void* object, std::size_t bytes) {
  transport::Participant* const at = transport::Participant::at(&arena);
  if (at == nullptr) refuse_unknown();
  transport::Participant& p = *at;
  if (!p.same_segment(*target)) {
    throw Error(EINVAL, p.segment().path(), "a message can not refer to one in another segment",
                "copy it, or put both topics into one segment");
  }
  if (target->hub != p.hub()) {  // it knows the target by an address in another mapping
    throw Error(
        EINVAL, p.segment().path(),
        "a message can not refer to one that another copy of the library has pulled or made",
        "pull it by the copy that makes the message");
  }
  if (!p.segment().holds(target->block, p.segment().offset_of(object), bytes)) {
    throw Error(EINVAL, p.segment().path(),
                "a message can not refer to what lies outside of the message that it would keep",
                "refer to that message or a part of it, or copy the object into the message");
  }
  // In a message of another home, the hold would belong to this process and its entry to the home.
  const std::uint32_t here = p.segment().block_of(arena);
  if (here >= p.blocks() || !p.holder().is_home(here)) {
    throw Error(EPERM, p.segment().path(),
                "a message that was received can not refer to others than it does",
                "make one of your own that refers to both");
  }
  if (arena.is_frozen()) {
    throw Error(EPERM, p.segment().path(),
                "a message that was published can not refer to others than it does",
                "build it wholly before push(), or copy it into a new loan()");
  }
  using Entry = ReferenceList::Entry;
  const std::uint32_t block = target->block;
  Entry* known = nullptr;
  Entry* free = nullptr;
  transport::each_entry(p.segment(), here, [&](Entry& entry) {
    if (entry.block == block) known = &entry;
    if (entry.block == ReferenceList::kNone && free == nullptr) free = &entry;
    return known == nullptr;
  });
  if (known != nullptr) {
    ++known->refs;
    return block;
  }
  if (free == nullptr) {
    auto* fresh = static_cast<ReferenceList*>(arena.allocate(sizeof(ReferenceList), 8));
    fresh->next = arena.references;
    for (Entry& entry : fresh->entry) entry = {ReferenceList::kNone, 0};
    // Release: the order matters to a kill only. Killed before, there is no list; after, a whole
    // one.
    std::atomic_ref(arena.references)
        .store(p.segment().offset_of(fresh), std::memory_order_release);
    free = &fresh->entry[0];
  }
  // The hold first, then its entry. Killed in between, the hold goes with this process's bit.
  p.holder().acquire(block, hold::kRing);
  free->refs = 1;
  write_once(free->block, block);
  return block;
}

void unrefer(Arena& arena, std::uint32_t block) noexcept {
  if (arena.is_frozen()) return;
  transport::Participant* const p = transport::Participant::at(&arena);
  if (p == nullptr) return;
  const std::uint32_t here = p->segment().block_of(arena);
  if (here >= p->blocks() || !p->holder().is_home(here)) return;  // only the home changes an entry
  if (block >= p->blocks()) return;                               // the reference is damaged
  using Entry = ReferenceList::Entry;
  Entry* known = nullptr;
  transport::each_entry(p->segment(), here, [&](Entry& entry) {
    if (entry.block == block) known = &entry;
    return known == nullptr;
  });
  if (known == nullptr || --known->refs != 0) return;
  // The entry first, then its hold, which is released. Killed in between, the hold goes with this
  // process's bit.
  write_once<std::uint32_t>(known->block, ReferenceList::kNone);
  p->holder().release(block, hold::kRing);
}

}  // namespace lot::detail
