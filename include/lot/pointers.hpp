// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <ostream>
#include <type_traits>
#include <utility>
#if __cplusplus >= 202002L
#include <compare>
#endif

#include "lot/detail/control.hpp"
#include "lot/detail/raise.hpp"

namespace lot {

template <class T>
class ShmUniquePtr;
template <class T>
class ShmSharedPtr;
template <class T>
class ShmWeakPtr;

namespace detail {
struct PointerAccess;

/// Whether the message of the first control block comes before the second's. A block has one
/// message after another: its generation says which.
inline bool owner_less(const ControlBlock* a, std::uint32_t a_generation, const ControlBlock* b,
                       std::uint32_t b_generation) noexcept {
  return a == b ? a_generation < b_generation : std::less<const ControlBlock*>()(a, b);
}

template <class From, class To>
using EnableIfConvertible = std::enable_if_t<std::is_convertible_v<From*, To*>, int>;

/// The pointers of this library that compare by address, with each other and with nullptr.
template <class P>
struct IsPointer : std::false_type {};
template <class T>
struct IsPointer<ShmUniquePtr<T>> : std::true_type {};
template <class T>
struct IsPointer<ShmSharedPtr<T>> : std::true_type {};
template <class P>
using EnableIfPointer = std::enable_if_t<IsPointer<P>::value, int>;
template <class P, class Q>
using EnableIfPointers = std::enable_if_t<IsPointer<P>::value && IsPointer<Q>::value, int>;
}  // namespace detail

/// A message in shared memory that only its maker can see: it is built through this, then pushed or
/// turned into a ShmSharedPtr, both without a copy.
///
/// Threads: as std::unique_ptr. In a forked child what it has inherited does nothing.
/// Errors:  no member throws. The containers of the message do when they grow: see ShmAllocator.
/// Memory:  two words; the message has its memory in the segment until the pointer has gone.
/// Crash:   another process frees the message.
template <class T>
class ShmUniquePtr {
 public:
  using element_type = T;
  using pointer = T*;

  constexpr ShmUniquePtr() noexcept = default;
  /// Null.
  constexpr ShmUniquePtr(std::nullptr_t) noexcept {}
  ShmUniquePtr(ShmUniquePtr&& other) noexcept
      : object_(std::exchange(other.object_, nullptr)),
        control_(std::exchange(other.control_, nullptr)) {}
  /// Takes over a pointer to a derived or a mutable type.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmUniquePtr(ShmUniquePtr<U>&& other) noexcept
      : object_(std::exchange(other.object_, nullptr)),
        control_(std::exchange(other.control_, nullptr)) {}
  ShmUniquePtr& operator=(ShmUniquePtr&& other) noexcept {
    ShmUniquePtr(std::move(other)).swap(*this);
    return *this;
  }
  /// Frees the message, and takes that of `other` over.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmUniquePtr& operator=(ShmUniquePtr<U>&& other) noexcept {
    ShmUniquePtr(std::move(other)).swap(*this);
    return *this;
  }
  /// Frees the message.
  ShmUniquePtr& operator=(std::nullptr_t) noexcept {
    reset();
    return *this;
  }
  ~ShmUniquePtr() { reset(); }

  /// The message, or null.
  T* get() const noexcept { return object_; }
  /// The message. REQUIRES: there is one.
  T& operator*() const noexcept { return *object_; }
  /// A member of the message. REQUIRES: there is one.
  T* operator->() const noexcept { return object_; }
  /// False: it is null.
  [[nodiscard]] explicit operator bool() const noexcept { return object_ != nullptr; }

  /// Frees the message.
  void reset() noexcept {
    if (control_ != nullptr) {
      object_ = nullptr;
      detail::ControlBlock* control = std::exchange(control_, nullptr);
      control->hub->abandoned(control);
    }
  }
  /// Exchanges the messages.
  void swap(ShmUniquePtr& other) noexcept {
    std::swap(object_, other.object_);
    std::swap(control_, other.control_);
  }

 private:
  template <class U>
  friend class ShmUniquePtr;
  friend struct detail::PointerAccess;
  ShmUniquePtr(T* object, detail::ControlBlock* control) noexcept
      : object_(object), control_(control) {}

  T* object_ = nullptr;
  detail::ControlBlock* control_ = nullptr;
};

/// A shared pointer to a message in shared memory, across processes.
///
/// It behaves as std::shared_ptr and boost::interprocess::shared_ptr do: copies, moves, converts to
/// const, aliases, casts, has a weak form. Copying it counts in private memory of this process;
/// only the first and the last pointer of a process touch the segment. The message lives while any
/// process has a pointer to it: after the callback, after unsubscribing, after its publisher's
/// death.
///
/// After a push of a ShmSharedPtr<T> the message can not grow: its containers throw lot::Error. Its
/// elements can still be written through the pointer, while readers look at them: the library
/// cannot prevent that, the program must not do it.
///
/// Threads: distinct objects freely, one object with synchronisation. In a forked child what it has
///          inherited counts nothing.
/// Errors:  no member throws, but for the constructor from a ShmWeakPtr.
/// Memory:  two words; get() is one load. The object itself belongs in private memory: in a message
///          use ShmRef.
/// Crash:   another process takes the dead one's holds away; the message lives on while others have
///          it.
template <class T>
class ShmSharedPtr {
 public:
  using element_type = T;
  using value_type = T;
  using pointer = T*;
  using weak_type = ShmWeakPtr<T>;

  constexpr ShmSharedPtr() noexcept = default;
  /// Null.
  constexpr ShmSharedPtr(std::nullptr_t) noexcept {}
  ShmSharedPtr(const ShmSharedPtr& other) noexcept : ShmSharedPtr(other, other.object_) {}
  ShmSharedPtr(ShmSharedPtr&& other) noexcept
      : object_(std::exchange(other.object_, nullptr)),
        control_(std::exchange(other.control_, nullptr)) {}
  /// Shares the message of a pointer to a derived or a mutable type.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmSharedPtr(const ShmSharedPtr<U>& other) noexcept : ShmSharedPtr(other, other.get()) {}
  /// Takes over such a pointer.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmSharedPtr(ShmSharedPtr<U>&& other) noexcept
      : object_(std::exchange(other.object_, nullptr)),
        control_(std::exchange(other.control_, nullptr)) {}
  /// Aliasing: points to `part`, keeps alive what `other` keeps alive.
  template <class U>
  ShmSharedPtr(const ShmSharedPtr<U>& other, T* part) noexcept
      : object_(part), control_(other.control_) {
    if (control_ != nullptr) control_->hold.add_pointer();
  }
  /// The same, and `other` is null afterwards.
  template <class U>
  ShmSharedPtr(ShmSharedPtr<U>&& other, T* part) noexcept
      : object_(part), control_(std::exchange(other.control_, nullptr)) {
    other.object_ = nullptr;
  }
  /// Unique becomes shared; nothing is copied.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmSharedPtr(ShmUniquePtr<U>&& unique) noexcept;
  /// Throws std::bad_weak_ptr when the message has died.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  explicit ShmSharedPtr(const ShmWeakPtr<U>& weak);
  ~ShmSharedPtr() {
    if (control_ != nullptr) control_->drop_pointer();
  }

  ShmSharedPtr& operator=(const ShmSharedPtr& other) noexcept {
    ShmSharedPtr(other).swap(*this);
    return *this;
  }
  ShmSharedPtr& operator=(ShmSharedPtr&& other) noexcept {
    ShmSharedPtr(std::move(other)).swap(*this);
    return *this;
  }
  /// Lets its message go, and shares that of `other`.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmSharedPtr& operator=(const ShmSharedPtr<U>& other) noexcept {
    ShmSharedPtr(other).swap(*this);
    return *this;
  }
  /// Lets its message go, and takes that of `other` over.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmSharedPtr& operator=(ShmSharedPtr<U>&& other) noexcept {
    ShmSharedPtr(std::move(other)).swap(*this);
    return *this;
  }
  /// Lets its message go, and takes the unique one over; nothing is copied.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmSharedPtr& operator=(ShmUniquePtr<U>&& unique) noexcept {
    ShmSharedPtr(std::move(unique)).swap(*this);
    return *this;
  }

  /// The message, or the part of it that the pointer is to, or null.
  T* get() const noexcept { return object_; }
  /// The same as a reference. REQUIRES: it is not null.
  std::add_lvalue_reference_t<T> operator*() const noexcept { return *object_; }
  /// A member of it. REQUIRES: it is not null.
  T* operator->() const noexcept { return object_; }
  /// False: it is null.
  [[nodiscard]] explicit operator bool() const noexcept { return object_ != nullptr; }

  /// Lets the message go, and is null.
  void reset() noexcept { ShmSharedPtr().swap(*this); }
  /// Exchanges the pointers.
  void swap(ShmSharedPtr& other) noexcept {
    std::swap(object_, other.object_);
    std::swap(control_, other.control_);
  }

  /// Pointers in this process, and one for each other process that has some (or forwards the
  /// message). Neither the publisher's queue nor borrows count: for "may I change it?" ask
  /// unique().
  long use_count() const noexcept {
    if (control_ == nullptr) return 0;
    // O4: when it counts one pointer, the threads that dropped the others have read all that they
    // wanted to.
    const auto here = detail::hold::pointers(control_->hold.load(std::memory_order_acquire));
    return static_cast<long>(here + control_->hub->others(control_));
  }
  /// True when nothing else can see the message: this is the only pointer, and no queue, reader,
  /// other message or other process has it. While it may be seen the answer is false, also for some
  /// time longer: until the publisher has taken the message back from its queue. A process that has
  /// received the message hears false as long as the process that made it stays, which may publish
  /// it again at any time; but for an item that it has taken from a queue and not published since,
  /// and for a message of PusherOptions::fast_lane, which is a copy of this process.
  [[nodiscard]] bool unique() const noexcept {
    return control_ != nullptr && control_->hub->alone(control_);
  }

  /// Orders by message: pointers to parts of one message are equal.
  template <class U>
  bool owner_before(const ShmSharedPtr<U>& other) const noexcept {
    return std::less<const void*>()(control_,
                                    other.control_);  // both live: one control, one message
  }
  /// The same beside a message that may have died.
  template <class U>
  bool owner_before(const ShmWeakPtr<U>& other) const noexcept {
    return detail::owner_less(control_, generation(), other.control_, other.generation_);
  }

 private:
  template <class U>
  friend class ShmSharedPtr;
  template <class U>
  friend class ShmWeakPtr;
  friend struct detail::PointerAccess;
  ShmSharedPtr(T* object, detail::ControlBlock* control) noexcept
      : object_(object), control_(control) {}
  std::uint32_t generation() const noexcept {
    return control_ != nullptr ? control_->hub->generation(control_) : 0;
  }

  T* object_ = nullptr;
  detail::ControlBlock* control_ = nullptr;
};

/// Looks after a message without keeping it alive.
///
/// Threads: as std::weak_ptr: distinct objects freely, one object with synchronisation.
/// Errors:  no member throws.
/// Memory:  three words; the message's memory is used again when it has died.
/// Crash:   nothing of it is in the segment.
template <class T>
class ShmWeakPtr {
 public:
  using element_type = T;

  constexpr ShmWeakPtr() noexcept = default;
  ShmWeakPtr(const ShmWeakPtr& other) noexcept
      : ShmWeakPtr(other.object_, other.control_, other.generation_) {}
  ShmWeakPtr(ShmWeakPtr&& other) noexcept { swap(other); }
  /// Looks on after the message of such a pointer in its place, which looks after nothing then.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmWeakPtr(ShmWeakPtr<U>&& other) noexcept
      : object_(other.template object_as<T>()),
        control_(std::exchange(other.control_, nullptr)),
        generation_(std::exchange(other.generation_, 0)) {
    other.object_ = nullptr;
  }
  /// Looks after the message of a pointer to a derived or a mutable type.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmWeakPtr(const ShmWeakPtr<U>& other) noexcept
      : ShmWeakPtr(other.template object_as<T>(), other.control_, other.generation_) {}
  /// Looks after the message of a shared pointer.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmWeakPtr(const ShmSharedPtr<U>& shared) noexcept
      : ShmWeakPtr(shared.object_, shared.control_, shared.generation()) {}
  ~ShmWeakPtr() {
    if (control_ != nullptr) control_->hub->weak_count(control_, -1);
  }
  ShmWeakPtr& operator=(const ShmWeakPtr& other) noexcept {
    ShmWeakPtr(other).swap(*this);
    return *this;
  }
  ShmWeakPtr& operator=(ShmWeakPtr&& other) noexcept {
    ShmWeakPtr(std::move(other)).swap(*this);
    return *this;
  }
  /// Looks after that message from now on.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmWeakPtr& operator=(const ShmWeakPtr<U>& other) noexcept {
    ShmWeakPtr(other).swap(*this);
    return *this;
  }
  /// The same, and `other` looks after nothing then.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmWeakPtr& operator=(ShmWeakPtr<U>&& other) noexcept {
    ShmWeakPtr(std::move(other)).swap(*this);
    return *this;
  }
  /// Looks after that message from now on.
  template <class U, detail::EnableIfConvertible<U, T> = 0>
  ShmWeakPtr& operator=(const ShmSharedPtr<U>& shared) noexcept {
    ShmWeakPtr(shared).swap(*this);
    return *this;
  }

  /// A pointer to the message, or null when it has died.
  [[nodiscard]] ShmSharedPtr<T> lock() const noexcept {
    if (control_ == nullptr || !control_->hub->lock_weak(control_, generation_)) return {};
    return {object_, control_};
  }
  /// As that of a ShmSharedPtr to the message; 0 when it has died.
  long use_count() const noexcept {
    const ShmSharedPtr<T> shared = lock();
    return shared.control_ != nullptr ? shared.use_count() - 1 : 0;
  }
  /// True when the message has died, or when this process has left the segment: lock() is null
  /// then. (A message that only the publisher's queue holds has not died, where it travels in a
  /// block: PusherOptions::fast_lane.)
  [[nodiscard]] bool expired() const noexcept {
    return control_ == nullptr || control_->hub->expired(control_, generation_);
  }
  /// Looks after nothing any more.
  void reset() noexcept { ShmWeakPtr().swap(*this); }
  /// Exchanges the pointers.
  void swap(ShmWeakPtr& other) noexcept {
    std::swap(object_, other.object_);
    std::swap(control_, other.control_);
    std::swap(generation_, other.generation_);
  }
  /// Orders by message, dead or alive: the next message in the same memory is another one.
  template <class U>
  bool owner_before(const ShmWeakPtr<U>& other) const noexcept {
    return detail::owner_less(control_, generation_, other.control_, other.generation_);
  }
  /// The same beside a message that lives.
  template <class U>
  bool owner_before(const ShmSharedPtr<U>& other) const noexcept {
    return detail::owner_less(control_, generation_, other.control_, other.generation());
  }

 private:
  template <class U>
  friend class ShmWeakPtr;
  template <class U>
  friend class ShmSharedPtr;
  ShmWeakPtr(T* object, detail::ControlBlock* control, std::uint32_t generation) noexcept
      : object_(object), control_(control), generation_(generation) {
    if (control_ != nullptr) control_->hub->weak_count(control_, 1);
  }
  /// A conversion to a virtual base reads the object, which must be alive for that: of a dead one
  /// it is null.
  template <class U>
  U* object_as() const noexcept {
    if constexpr (std::is_same_v<std::remove_cv_t<T>, std::remove_cv_t<U>>) {
      return object_;
    } else {
      return lock().get();
    }
  }

  T* object_ = nullptr;
  detail::ControlBlock* control_ = nullptr;
  std::uint32_t generation_ = 0;
};

namespace detail {
/// How pushers, pullers and ShmRef make and take pointers.
struct PointerAccess {
  template <class T>
  static ShmUniquePtr<T> unique(T* object, ControlBlock* control) noexcept {
    return {object, control};
  }
  template <class T>
  static ShmSharedPtr<T> shared(T* object, ControlBlock* control) noexcept {
    return {object, control};
  }
  template <class Pointer>
  static ControlBlock* control(const Pointer& p) noexcept {
    return p.control_;
  }
  /// Takes what the pointer holds out of it.
  template <class Pointer>
  static ControlBlock* take(Pointer& p) noexcept {
    p.object_ = nullptr;
    return std::exchange(p.control_, nullptr);
  }
};
}  // namespace detail

template <class T>
template <class U, detail::EnableIfConvertible<U, T>>
ShmSharedPtr<T>::ShmSharedPtr(ShmUniquePtr<U>&& unique) noexcept : object_(unique.get()) {
  control_ = detail::PointerAccess::take(unique);
  if (control_ != nullptr) control_->hub->shared_from_unique(control_);
}

template <class T>
template <class U, detail::EnableIfConvertible<U, T>>
ShmSharedPtr<T>::ShmSharedPtr(const ShmWeakPtr<U>& weak) : ShmSharedPtr(weak.lock()) {
  if (control_ == nullptr) detail::raise_expired();
}

/// The paper's helper: the same message, read only.
template <class T>
[[nodiscard]] ShmSharedPtr<const T> make_const(ShmSharedPtr<T> pointer) noexcept {
  return ShmSharedPtr<const T>(std::move(pointer));
}

/// A pointer to the same message, cast by static_cast.
template <class T, class U>
[[nodiscard]] ShmSharedPtr<T> static_pointer_cast(const ShmSharedPtr<U>& p) noexcept {
  return {p, static_cast<T*>(p.get())};
}
/// A pointer to the same message, cast by const_cast. Readers look at what was pushed: do not
/// write.
template <class T, class U>
[[nodiscard]] ShmSharedPtr<T> const_pointer_cast(const ShmSharedPtr<U>& p) noexcept {
  return {p, const_cast<T*>(p.get())};
}
/// A pointer to the same message, cast by dynamic_cast; null if the object is no T. It needs RTTI.
template <class T, class U>
[[nodiscard]] ShmSharedPtr<T> dynamic_pointer_cast(
    [[maybe_unused]] const ShmSharedPtr<U>& p) noexcept {
#ifdef __cpp_rtti
  if (T* object = dynamic_cast<T*>(p.get())) return {p, object};
#else
  static_assert(sizeof(ShmSharedPtr<U>) == 0,
                "lot: dynamic_pointer_cast needs RTTI: compile without -fno-rtti, or use "
                "lot::static_pointer_cast");
#endif
  return {};
}
/// A pointer to the same message, cast by reinterpret_cast.
template <class T, class U>
[[nodiscard]] ShmSharedPtr<T> reinterpret_pointer_cast(const ShmSharedPtr<U>& p) noexcept {
  return {p, reinterpret_cast<T*>(p.get())};
}

/// As get(), for code that takes pointers of any kind.
template <class T>
T* to_raw_pointer(const ShmSharedPtr<T>& p) noexcept {
  return p.get();
}

// Pointers compare by address, as raw pointers do.
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator==(const P& a, const Q& b) noexcept -> decltype(a.get() == b.get()) {
  return a.get() == b.get();
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator==(const P& p, std::nullptr_t) noexcept {
  return p.get() == nullptr;
}
#if __cplusplus >= 202002L
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator<=>(const P& a, const Q& b) noexcept
    -> decltype(std::compare_three_way()(a.get(), b.get())) {
  return std::compare_three_way()(a.get(), b.get());
}
template <class P, detail::EnableIfPointer<P> = 0>
std::strong_ordering operator<=>(const P& p, std::nullptr_t) noexcept {
  return std::compare_three_way()(p.get(), static_cast<decltype(p.get())>(nullptr));
}
#else
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator!=(const P& a, const Q& b) noexcept -> decltype(a.get() != b.get()) {
  return a.get() != b.get();
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator!=(const P& p, std::nullptr_t) noexcept {
  return p.get() != nullptr;
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator==(std::nullptr_t, const P& p) noexcept {
  return p.get() == nullptr;
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator!=(std::nullptr_t, const P& p) noexcept {
  return p.get() != nullptr;
}
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator<(const P& a, const Q& b) noexcept -> decltype(a.get() < b.get()) {
  return std::less<decltype(true ? a.get() : b.get())>()(a.get(), b.get());
}
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator>(const P& a, const Q& b) noexcept -> decltype(b < a) {
  return b < a;
}
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator<=(const P& a, const Q& b) noexcept -> decltype(b < a) {
  return !(b < a);
}
template <class P, class Q, detail::EnableIfPointers<P, Q> = 0>
auto operator>=(const P& a, const Q& b) noexcept -> decltype(a < b) {
  return !(a < b);
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator<(const P& p, std::nullptr_t) noexcept {
  return std::less<decltype(p.get())>()(p.get(), nullptr);
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator<(std::nullptr_t, const P& p) noexcept {
  return std::less<decltype(p.get())>()(nullptr, p.get());
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator>(const P& p, std::nullptr_t) noexcept {
  return nullptr < p;
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator>(std::nullptr_t, const P& p) noexcept {
  return p < nullptr;
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator<=(const P& p, std::nullptr_t) noexcept {
  return !(nullptr < p);
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator<=(std::nullptr_t, const P& p) noexcept {
  return !(p < nullptr);
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator>=(const P& p, std::nullptr_t) noexcept {
  return !(p < nullptr);
}
template <class P, detail::EnableIfPointer<P> = 0>
bool operator>=(std::nullptr_t, const P& p) noexcept {
  return !(nullptr < p);
}
#endif

/// Exchanges the pointers.
template <class T>
void swap(ShmSharedPtr<T>& a, ShmSharedPtr<T>& b) noexcept {
  a.swap(b);
}
/// Exchanges the pointers.
template <class T>
void swap(ShmUniquePtr<T>& a, ShmUniquePtr<T>& b) noexcept {
  a.swap(b);
}
/// Exchanges the pointers.
template <class T>
void swap(ShmWeakPtr<T>& a, ShmWeakPtr<T>& b) noexcept {
  a.swap(b);
}
/// Prints the address in this process. Throws what the stream throws.
template <class P, detail::EnableIfPointer<P> = 0>
std::ostream& operator<<(std::ostream& out, const P& p) {
  return out << static_cast<const void*>(p.get());
}

/// Orders by message: pointers to parts of one message are equal. For sets and maps of
/// ShmSharedPtr and ShmWeakPtr, also mixed.
struct owner_less {
  using is_transparent = void;
  /// a.owner_before(b). Throws nothing.
  template <class P, class Q>
  auto operator()(const P& a, const Q& b) const noexcept -> decltype(a.owner_before(b)) {
    return a.owner_before(b);
  }
};

/// ShmSharedPtr(std::move(unique)) needs no type. Throws nothing.
template <class T>
ShmSharedPtr(ShmUniquePtr<T>) -> ShmSharedPtr<T>;
/// ShmSharedPtr(weak) needs no type. Throws std::bad_weak_ptr when the message has died.
template <class T>
ShmSharedPtr(ShmWeakPtr<T>) -> ShmSharedPtr<T>;
/// ShmWeakPtr(shared) needs no type. Throws nothing.
template <class T>
ShmWeakPtr(ShmSharedPtr<T>) -> ShmWeakPtr<T>;

}  // namespace lot

namespace std {  // open, since doxygen does not follow the short form
/// As that of the raw pointer.
template <class T>
struct hash<lot::ShmSharedPtr<T>> {
  std::size_t operator()(const lot::ShmSharedPtr<T>& p) const noexcept {
    return std::hash<T*>()(p.get());
  }
};
/// As that of the raw pointer.
template <class T>
struct hash<lot::ShmUniquePtr<T>> {
  std::size_t operator()(const lot::ShmUniquePtr<T>& p) const noexcept {
    return std::hash<T*>()(p.get());
  }
};
/// lot::owner_less, for containers that name this one.
template <class T>
struct owner_less<lot::ShmSharedPtr<T>> : lot::owner_less {};
/// The same.
template <class T>
struct owner_less<lot::ShmWeakPtr<T>> : lot::owner_less {};
}  // namespace std
