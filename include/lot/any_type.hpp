// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/compliance.hpp"
#include "lot/describe.hpp"
#include "lot/description.hpp"
#include "lot/detail/control.hpp"
#include "lot/detail/message_type.hpp"

namespace lot {

namespace registry {
class KnownType;
}

namespace detail {

/// What a program knows of a type, for AnyType. Throws std::bad_alloc.
std::shared_ptr<const registry::KnownType> make_known_type(const MessageType& type,
                                                           Description description);

inline namespace LOT_NAMES {

/// The same of T, made once.
template <class T>
[[gnu::visibility("hidden")]] const std::shared_ptr<const registry::KnownType>& known_type() {
  // Never destroyed: static objects may publish in their destructors.
  static const auto* const type = new std::shared_ptr<const registry::KnownType>(
      make_known_type(message_type<T>(), describe<T>()));
  return *type;
}

}  // namespace LOT_NAMES

}  // namespace detail

/// A message type, to a program that may not have it: what ShmEngine::type_of() says of a topic, or
/// what a program has made while it runs.
///
///     const auto box = lot::AnyType::structure(
///         "Box", {{"x", lot::AnyType::number(lot::Kind::Float, 4)},
///                 {"label", lot::AnyType::string()}});
///
/// Threads: distinct objects freely, one object with synchronisation.
/// Errors:  of() throws std::bad_alloc at its first call for a type; description() throws
///          lot::Error (EBADMSG) when another process has damaged what the topic says; what makes
///          a type throws lot::Error (EINVAL).
/// Memory:  a share of the description, which lies in private memory.
/// Crash:   nothing of it is shared with other processes.
class AnyType {
 public:
  struct Field;

  /// None.
  AnyType() noexcept = default;
  /// For ShmEngine::type_of(). Throws nothing.
  explicit AnyType(std::shared_ptr<const registry::KnownType> type) noexcept
      : type_(std::move(type)) {}
  /// A type of this program. Throws std::bad_alloc.
  template <class T>
  [[nodiscard]] static AnyType of() {
    using Plain = std::remove_cv_t<T>;
    assert_message<Plain>();
    return AnyType(detail::known_type<Plain>());
  }

  // ---- types that are made while the program runs: for other languages, and from files ----
  //
  // A type lies as the C++ compiler lays its C++ type out, of the standard library that this
  // library was built with. So it is_same() as that type if the names are equal. Each throws
  // lot::Error (EINVAL) for what cannot be, or is too large for a description (docs/layout.md), and
  // std::bad_alloc.

  /// A number: Bool, Char, Int, UInt or Float of so many bytes. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType number(Kind kind, std::size_t size);
  /// A ShmString. Throws std::bad_alloc.
  [[nodiscard]] static AnyType string();
  /// A ShmVector of them. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType vector(const AnyType& element);
  /// A std::array of them; it lies as an array of C. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType array(const AnyType& element, std::size_t count);
  /// A ShmRef to a message of that type. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType reference(const AnyType& target);
  /// An enum that lies as that Int, UInt, Bool or Char. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType enumeration(std::string name, const AnyType& number);
  /// A std::chrono::duration: so many seconds, numerator / denominator, are one. Throws lot::Error,
  /// std::bad_alloc.
  [[nodiscard]] static AnyType duration(const AnyType& number, std::int64_t numerator,
                                        std::int64_t denominator);
  /// A time point of the "system_clock" or the "steady_clock". Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType time_point(std::string clock, const AnyType& duration);
  /// A struct of these, in this order, each at the next multiple of its alignment. `name` is what
  /// TypeIdentity says: the C++ name, with namespaces. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType structure(std::string name, const std::vector<Field>& fields);
  /// Bytes whose meaning only the type's own programs know: as is_trusted_message. Throws
  /// lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType opaque(std::string name, std::size_t size, std::size_t alignment);
  /// The type that encoded() told, of that name, alignment and TypeIdentity::hash(). The bytes need
  /// not be trusted. Throws lot::Error, std::bad_alloc.
  [[nodiscard]] static AnyType decoded(std::string name, std::size_t alignment,
                                       std::string_view bytes, std::uint64_t hash = 0);
  /// The description as bytes (docs/layout.md); empty where it is too large. REQUIRES: it is one.
  /// Throws lot::Error (EBADMSG), std::bad_alloc.
  [[nodiscard]] std::string encoded() const;

  /// False: it is none.
  [[nodiscard]] explicit operator bool() const noexcept { return type_ != nullptr; }
  /// Its name, as TypeIdentity says; of a topic, at most 231 bytes of it. REQUIRES: it is one.
  /// Throws nothing.
  const std::string& name() const noexcept;
  /// What it is made of: one opaque value where a topic has no description. REQUIRES: it is one.
  /// Throws lot::Error (EBADMSG).
  const Description& description() const;
  /// Bytes of a message, without what its vectors and strings have. REQUIRES: it is one. Throws
  /// nothing.
  std::size_t size() const noexcept;
  /// A message lies at a multiple of it. REQUIRES: it is one. Throws nothing.
  std::size_t alignment() const noexcept;
  /// The type of a field, by its place. REQUIRES: it is one. Throws lot::Error (EINVAL: there is no
  /// such field; EBADMSG), std::bad_alloc.
  [[nodiscard]] AnyType field(std::size_t i) const;
  /// The type of what it holds: of an array, vector, reference, enum, duration or time point; else
  /// none. REQUIRES: it is one. Throws lot::Error (EBADMSG), std::bad_alloc.
  [[nodiscard]] AnyType element() const;
  /// True when a message of the one type may be read as one of the other: name, size, alignment,
  /// identity and layout are equal, and each name of a field that both know. Throws
  /// std::bad_alloc.
  [[nodiscard]] bool is_same(const AnyType& other) const;

  /// What it is for the library. Throws nothing.
  const std::shared_ptr<const registry::KnownType>& known() const noexcept { return type_; }

 private:
  std::shared_ptr<const registry::KnownType> type_;
};

/// What a struct has. For AnyType::structure().
struct AnyType::Field {
  std::string name;  ///< empty: it has none
  AnyType type;      ///< what lies there
};

}  // namespace lot
