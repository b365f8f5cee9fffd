// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <functional>
#include <limits>
#include <new>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/compliance.hpp"
#include "lot/detail/arena.hpp"
#include "lot/detail/core.hpp"
#include "lot/detail/offset_ptr.hpp"
#include "lot/detail/raise.hpp"
#include "lot/pointers.hpp"

#ifdef _LIBCPP_VERSION
#ifndef BOOST_NO_CXX98_FUNCTION_BASE
#define BOOST_NO_CXX98_FUNCTION_BASE  // Boost 1.74 does not know that libc++ has none
#endif
#include <boost/container/string.hpp>
#endif

/// What messages are made of beside plain data: strings, vectors and references to other messages.
namespace lot {

/// The allocator of containers in messages.
///
/// It knows the message that it allocates in, or none: then it is the ordinary heap. A container
/// that is default-constructed while a message is built by loan() belongs to that message; any
/// other is on the heap. Containers of different messages never steal each other's memory: a move
/// between them copies, and so `Frame mine = *seen;` is an ordinary private copy. (As with every
/// allocator, swapping two containers of different messages is undefined.)
///
/// Memory grows only while the message is built, since afterwards all readers see it as const. It
/// is not zeroed: resize() default-initialises, so trivial elements hold what was there before.
///
/// Threads: a message is built by one thread at a time; const containers are read by any number.
/// Errors:  allocate() throws, and so what makes a container grow: lot::OutOfMemory when the
///          segment is full, or when another process has made the message; lot::Error: EPERM when
///          the message is published, ECHILD in a forked child and in a process that was taken for
///          dead, EINVAL when another copy of the library has made the message, EBADMSG when
///          another process has damaged it. On the heap: std::bad_alloc.
/// Memory:  one word in each container, which is relative: any process may read it.
/// Crash:   the memory belongs to the message, and goes with it.
template <class T>
class ShmAllocator {
 public:
  using value_type = T;
  using pointer = detail::OffsetPtr<T>;
  using const_pointer = detail::OffsetPtr<const T>;
  using void_pointer = detail::OffsetPtr<void>;
  using const_void_pointer = detail::OffsetPtr<const void>;
  using size_type = std::size_t;
  using difference_type = std::ptrdiff_t;
  using propagate_on_container_copy_assignment = std::false_type;
  using propagate_on_container_move_assignment = std::false_type;
  using propagate_on_container_swap = std::false_type;
  using is_always_equal = std::false_type;
  template <class U>
  struct rebind {
    using other = ShmAllocator<U>;
  };

  /// Allocates in the message that this thread builds just now, else on the heap.
  ShmAllocator() noexcept : arena_(detail::arena_being_built()) {}
  ShmAllocator(const ShmAllocator& other) noexcept = default;
  /// Allocates in the same message as `other`, or on the heap as `other` does.
  template <class U>
  ShmAllocator(const ShmAllocator<U>& other) noexcept : arena_(other.arena()) {}
  ShmAllocator& operator=(const ShmAllocator&) noexcept = default;

  /// Memory for n elements, not zeroed. Throws lot::OutOfMemory, lot::Error and std::bad_alloc as
  /// the class says.
  [[nodiscard]] pointer allocate(std::size_t n) {
    if (n > std::numeric_limits<std::size_t>::max() / 2 / sizeof(T)) detail::raise_too_large();
    if (detail::Arena* arena = arena_.get()) {
      return pointer(static_cast<T*>(arena->allocate(n * sizeof(T), alignof(T))));
    }
    return pointer(static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(alignof(T)))));
  }
  /// Takes memory back that the same message, or the heap, has given. Of a message that is
  /// published it stays until the message dies.
  void deallocate(const pointer& p, std::size_t n) noexcept {
    if (detail::Arena* arena = arena_.get()) {
      arena->deallocate(p.get(), n * sizeof(T));
    } else {
      ::operator delete(p.get(), std::align_val_t(alignof(T)));
    }
  }

  /// Elements that are containers get this allocator too, so that cloud->fields.resize(4) stays in
  /// the message; trivial elements are left as they are. Throws what the constructor throws.
  template <class U, class... Args>
  void construct(U* place, Args&&... args) {
    // A trivial element needs no scope; the loop over a resize() then vanishes in the compiler.
    if constexpr (std::is_trivially_copyable_v<U>) {
      if constexpr (sizeof...(Args) == 0) {
        ::new (static_cast<void*>(place)) U;
      } else {
        ::new (static_cast<void*>(place)) U(std::forward<Args>(args)...);
      }
    } else if constexpr ((std::is_same_v<Args, U> && ...) && sizeof...(Args) == 1 &&
                         std::is_default_constructible_v<U> && std::is_move_assignable_v<U>) {
      // A move constructor would take the other's memory over, whichever that is; an assignment
      // does so only within one message.
      const detail::BuildScope scope(arena_.get());
      ::new (static_cast<void*>(place)) U;
      struct Undo {
        U* built;
        ~Undo() {
          if (built != nullptr) built->~U();
        }
      } undo{place};
      ((*place = std::forward<Args>(args)), ...);
      undo.built = nullptr;
    } else if constexpr (std::is_constructible_v<U, const Args&...>) {
      const detail::BuildScope scope(arena_.get());
      ::new (static_cast<void*>(place)) U(static_cast<const Args&>(args)...);
    } else {
      const detail::BuildScope scope(arena_.get());
      ::new (static_cast<void*>(place)) U(std::forward<Args>(args)...);
    }
  }

  /// The allocator that a copy of a container gets: of the message that this thread builds, else of
  /// the heap.
  ShmAllocator select_on_container_copy_construction() const noexcept { return ShmAllocator(); }

  /// The message that it allocates in; null: the heap.
  detail::Arena* arena() const noexcept { return arena_.get(); }

  friend bool operator==(const ShmAllocator& a, const ShmAllocator& b) noexcept {
    return a.arena() == b.arena();
  }
  friend bool operator!=(const ShmAllocator& a, const ShmAllocator& b) noexcept {
    return a.arena() != b.arena();
  }

 private:
  detail::OffsetPtr<detail::Arena> arena_;
};

/// Its pointers are relative.
template <class T>
struct is_shm_allocator<ShmAllocator<T>> : std::true_type {};

/// A string in a message: std's, but Boost's where std is libc++. That one moves the bytes of a
/// string, and a relative pointer would not survive it.
#ifdef _LIBCPP_VERSION
using ShmString = boost::container::basic_string<char, std::char_traits<char>, ShmAllocator<char>>;
#else
using ShmString = std::basic_string<char, std::char_traits<char>, ShmAllocator<char>>;
#endif

/// A vector in a message. resize() does not zero trivial elements.
template <class T>
using ShmVector = std::vector<T, ShmAllocator<T>>;

/// A ShmSharedPtr that is stored in a message: the message keeps its target alive, also when the
/// process that published it has died.
///
/// It may refer to a part of a message (an aliasing pointer), but to nothing outside of it. What it
/// referred to before is let go when it is assigned again, cleared or destroyed while the message
/// is built, else when the message dies. Outside of messages it works as well, and then simply
/// holds a ShmSharedPtr's share.
///
///     struct Detection { lot::ShmRef<const Frame> frame; float box[4]; };
///     detection->frame = seen;
///
/// Threads: as the message: one thread at a time builds it, any number read it.
/// Errors:  assignment throws lot::Error: EINVAL when the target is private memory, or lies in
///          another segment, or came to the process by another copy of the library; EPERM when the
///          message that the reference lies in was received, or was pushed as a ShmSharedPtr;
///          EBADMSG when a reference is damaged. lot::OutOfMemory when the message has no room to
///          note one more target. reset() and an assignment of nullptr throw nothing, also in a
///          published message: its readers then find null. Nor is an assignment refused in the
///          process that has made the message, pushed it as a ShmUniquePtr and pulled it again.
///          Such a change takes a const_cast, which is the program's own fault.
/// Memory:  32 bytes, and in the message a list with an entry for each target.
/// Crash:   what was published keeps its target for as long as it lives; what was only loaned is
///          freed and lets its target go.
template <class U>
class ShmRef {
 public:
  using element_type = U;

  /// Refers to nothing; in the message that this thread builds, else in private memory.
  ShmRef() noexcept : arena_(detail::arena_being_built()) {}
  /// The same.
  ShmRef(std::nullptr_t) noexcept : ShmRef() {}
  ShmRef(const ShmRef& other) : ShmRef() { assign(other.get(), other.control_here()); }
  /// Refers to what `target` points to; null where that has no message. Throws as an assignment.
  template <class V, detail::EnableIfConvertible<V, U> = 0>
  ShmRef(const ShmSharedPtr<V>& target) : ShmRef() {
    *this = target;
  }
  ShmRef& operator=(const ShmRef& other) {
    if (this != &other) assign(other.get(), other.control_here());
    return *this;
  }
  /// Refers to what `target` points to, and lets go of what it referred to; null where `target` has
  /// no message. Throws lot::Error and lot::OutOfMemory as the class says, and then refers to what
  /// it did.
  template <class V, detail::EnableIfConvertible<V, U> = 0>
  ShmRef& operator=(const ShmSharedPtr<V>& target) {
    assign(target.get(), detail::PointerAccess::control(target));
    return *this;
  }
  /// Refers to what another reference does, by a pointer to a base or to const. Throws as the class
  /// says.
  template <class V, detail::EnableIfConvertible<V, U> = 0>
  ShmRef(const ShmRef<V>& other) : ShmRef() {
    assign(other.get(), other.control_here());
  }
  /// The same, and lets go of what it referred to. Throws as the class says.
  template <class V, detail::EnableIfConvertible<V, U> = 0>
  ShmRef& operator=(const ShmRef<V>& other) {
    assign(other.get(), other.control_here());
    return *this;
  }
  /// Lets go of what it refers to.
  ShmRef& operator=(std::nullptr_t) noexcept {
    let_go();
    return *this;
  }
  ~ShmRef() { let_go(); }

  /// Lets go of what it refers to.
  void reset() noexcept { let_go(); }
  /// Exchanges the targets, also of references in different messages. Throws as an assignment, and
  /// then both refer to what they did.
  void swap(ShmRef& other) {
    const ShmSharedPtr<U> mine = lock();
    const ShmSharedPtr<U> others = other.lock();
    Hold here(*this, others.get(), detail::PointerAccess::control(others));
    Hold there(other, mine.get(), detail::PointerAccess::control(mine));
    here.refer();
    there.refer();
  }

  /// The target where it lies in this process, or null. If another process has damaged the
  /// reference, it may lead anywhere: lock() checks it.
  U* get() const noexcept { return target_.get(); }
  /// The target. REQUIRES: there is one.
  U& operator*() const noexcept { return *get(); }
  /// A member of the target. REQUIRES: there is one.
  U* operator->() const noexcept { return get(); }
  /// False: it refers to nothing.
  [[nodiscard]] explicit operator bool() const noexcept { return get() != nullptr; }

  /// A pointer of this process to the target. REQUIRES: the message is held or borrowed. Throws
  /// lot::Error: EBADMSG when the reference is damaged, EINVAL when this copy of the library has
  /// not joined the segment.
  [[nodiscard]] ShmSharedPtr<U> lock() const {
    return get() == nullptr
               ? ShmSharedPtr<U>()
               : detail::PointerAccess::shared(get(), detail::acquire_block(control_here()));
  }

 private:
  template <class V>
  friend class ShmRef;
  /// The target's control block in this process. A message says by its address which segment it is
  /// in: its own words may be damaged.
  detail::ControlBlock* control_here() const {
    if (get() == nullptr) return nullptr;
    detail::ControlBlock* control =
        detail::control_of(this, arena_.get() != nullptr, block_, get(), sizeof(U));
    return control != nullptr ? control : private_control_;
  }

  /// A hold on a target, for a reference that does not refer to it yet.
  class Hold {
   public:
    /// Throws as an assignment of the reference.
    Hold(ShmRef& ref, U* target, detail::ControlBlock* control) : ref_(ref) {
      if (target == nullptr || control == nullptr) return;
      if (detail::Arena* arena = ref.arena_.get()) {
        block_ = detail::refer(*arena, control, target, sizeof(U));
      } else {
        control_ = detail::acquire_block(control);
      }
      target_ = target;
    }
    ~Hold() { give_up(); }
    Hold(const Hold&) = delete;
    Hold& operator=(const Hold&) = delete;

    /// The reference lets go of its target, and refers to this one.
    void refer() noexcept {
      ref_.let_go();
      ref_.block_ = block_;
      ref_.private_control_ = std::exchange(control_, nullptr);
      ref_.target_ = std::exchange(target_, nullptr);
    }

   private:
    void give_up() noexcept {
      if (target_ == nullptr) return;
      if (detail::Arena* arena = ref_.arena_.get()) {
        detail::unrefer(*arena, block_);
      } else {
        control_->drop_pointer();
      }
    }

    ShmRef& ref_;
    U* target_ = nullptr;  ///< null: no hold
    detail::ControlBlock* control_ = nullptr;
    std::uint32_t block_ = 0;
  };

  /// The new target first: it may be kept alive by the old one alone.
  void assign(U* target, detail::ControlBlock* control) { Hold(*this, target, control).refer(); }

  void let_go() noexcept {
    if (target_.get() == nullptr) return;
    target_ = nullptr;
    if (detail::Arena* arena = arena_.get()) {
      detail::unrefer(*arena, block_);
    } else if (private_control_ != nullptr) {
      std::exchange(private_control_, nullptr)->drop_pointer();
    }
  }

  detail::OffsetPtr<detail::Arena> arena_;
  detail::OffsetPtr<U> target_;
  detail::ControlBlock* private_control_ = nullptr;  ///< outside of messages only
  std::uint32_t block_ = 0;                          ///< inside of messages only
};

namespace detail {
template <class U>
struct IsPointer<ShmRef<U>> : std::true_type {};
}  // namespace detail

/// Exchanges the targets. Throws as ShmRef::swap().
template <class U>
void swap(ShmRef<U>& a, ShmRef<U>& b) {
  a.swap(b);
}

/// Its words are relative.
template <class U>
struct is_trusted_message<ShmRef<U>> : std::true_type {};

}  // namespace lot

/// As that of the raw pointer: equal references in different messages have equal hashes.
template <class U>
struct std::hash<lot::ShmRef<U>> {
  std::size_t operator()(const lot::ShmRef<U>& ref) const noexcept {
    return std::hash<U*>()(ref.get());
  }
};

/// As std::string's: std has it for its own allocator only.
template <>
struct std::hash<lot::ShmString> {
  std::size_t operator()(const lot::ShmString& text) const noexcept {
    return std::hash<std::string_view>()(std::string_view(text.data(), text.size()));
  }
};
