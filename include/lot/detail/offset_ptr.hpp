// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <iterator>
#include <type_traits>

namespace lot::detail {

/// A pointer that stores the distance from itself to its target. So it means the same wherever a
/// process maps the segment. It converts to T*, which is what containers work with.
///
/// OffsetPtr computes with integers: for char* the compiler may assume that both ends lie in one
/// object.
template <class T>
class OffsetPtr {
  using Bytes = std::conditional_t<std::is_void_v<T>, char, T>;

 public:
  using element_type = T;
  using value_type = std::remove_cv_t<T>;
  using difference_type = std::ptrdiff_t;
  using pointer = OffsetPtr;
  using reference = Bytes&;  // Boost declares functions with it for pointers to void as well
  using iterator_category = std::random_access_iterator_tag;
#if __cplusplus > 201703L
  using iterator_concept = std::contiguous_iterator_tag;  // for std::span of a ShmVector
#endif
  template <class U>
  using rebind = OffsetPtr<U>;

  OffsetPtr() noexcept = default;
  OffsetPtr(T* target) noexcept { set(target); }  // nullptr and 0 too
  OffsetPtr(const OffsetPtr& other) noexcept { set(other.get()); }
  template <class U, std::enable_if_t<std::is_convertible_v<U*, T*>, int> = 0>
  OffsetPtr(const OffsetPtr<U>& other) noexcept {
    set(other.get());
  }
  template <class U, std::enable_if_t<!std::is_convertible_v<U*, T*>, int> = 0>
  explicit OffsetPtr(const OffsetPtr<U>& other) noexcept {
    set(static_cast<T*>(other.get()));
  }
  OffsetPtr& operator=(const OffsetPtr& other) noexcept {
    set(other.get());
    return *this;
  }
  template <class U, std::enable_if_t<std::is_convertible_v<U*, T*>, int> = 0>
  OffsetPtr& operator=(const OffsetPtr<U>& other) noexcept {
    set(other.get());
    return *this;
  }
  OffsetPtr& operator=(T* target) noexcept {
    set(target);
    return *this;
  }

  T* get() const noexcept {
    return offset_ == kNull ? nullptr : reinterpret_cast<T*>(hidden(this) + offset_);
  }
  operator T*() const noexcept { return get(); }
  reference operator*() const noexcept { return *get(); }
  T* operator->() const noexcept { return get(); }

  template <class U = T>
  static OffsetPtr pointer_to(std::enable_if_t<!std::is_void_v<U>, U>& object) noexcept {
    return OffsetPtr(&object);
  }

  OffsetPtr& operator++() noexcept { return *this += 1; }
  OffsetPtr& operator--() noexcept { return *this -= 1; }
  OffsetPtr operator++(int) noexcept {
    OffsetPtr old(*this);
    ++*this;
    return old;
  }
  OffsetPtr operator--(int) noexcept {
    OffsetPtr old(*this);
    --*this;
    return old;
  }
  OffsetPtr& operator+=(difference_type n) noexcept {
    offset_ += static_cast<std::uintptr_t>(n) * sizeof(Bytes);
    return *this;
  }
  OffsetPtr& operator-=(difference_type n) noexcept { return *this += -n; }

 private:
  /// No object begins one byte behind a pointer to it, so this offset is free to mean null.
  static constexpr std::uintptr_t kNull = 1;

  /// The address as a number about which the compiler knows nothing. Otherwise g++ -O3 takes an
  /// object at some distance from `this` for a part of *this, and reorders stores.
  static std::uintptr_t hidden(const volatile void* p) noexcept {
    auto address = reinterpret_cast<std::uintptr_t>(p);
    asm("" : "+r"(address));
    return address;
  }

  void set(T* target) noexcept {
    offset_ = target == nullptr ? kNull : hidden(target) - hidden(this);
  }

  std::uintptr_t offset_ = kNull;
};

// Sums and differences are ordinary pointers or go through them: T* converts back where it is kept.
template <class T, class N, std::enable_if_t<std::is_integral_v<N>, int> = 0>
OffsetPtr<T> operator+(const OffsetPtr<T>& p, N n) noexcept {
  return OffsetPtr<T>(p.get() + n);
}
template <class T, class N, std::enable_if_t<std::is_integral_v<N>, int> = 0>
OffsetPtr<T> operator+(N n, const OffsetPtr<T>& p) noexcept {
  return p + n;
}
template <class T, class N, std::enable_if_t<std::is_integral_v<N>, int> = 0>
OffsetPtr<T> operator-(const OffsetPtr<T>& p, N n) noexcept {
  return OffsetPtr<T>(p.get() - n);
}
template <class T, class U>
std::ptrdiff_t operator-(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() - b.get();
}
template <class T, class U>
bool operator==(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() == b.get();
}
template <class T, class U>
bool operator!=(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() != b.get();
}
template <class T, class U>
bool operator<(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() < b.get();
}
template <class T, class U>
bool operator>(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() > b.get();
}
template <class T, class U>
bool operator<=(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() <= b.get();
}
template <class T, class U>
bool operator>=(const OffsetPtr<T>& a, const OffsetPtr<U>& b) noexcept {
  return a.get() >= b.get();
}

}  // namespace lot::detail
