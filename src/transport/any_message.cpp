// SPDX-License-Identifier: Apache-2.0
#include "lot/any_message.hpp"

#include <cerrno>
#include <string>
#include <utility>

#include "lot/detail/mapping.hpp"
#include "lot/error.hpp"
#include "lot/message.hpp"

#include "description/compose.hpp"
#include "description/reader.hpp"
#include "description/wire.hpp"
#include "registry/known_type.hpp"

namespace lot {
namespace detail {
namespace {

const Mapping& mapping_of(const void* message) {
  const Mapping* const mapping = Mapping::of(message);
  if (mapping == nullptr) {
    throw Error(EINVAL, "message", "it lies in no segment that this copy of the library has joined",
                "read it by the copy of the library that pulled it");
  }
  return *mapping;
}

}  // namespace

std::shared_ptr<const registry::KnownType> make_known_type(const MessageType& type,
                                                           Description description) {
  return std::make_shared<const registry::KnownType>(type, std::move(description));
}

const MessageType& type_of(const registry::KnownType& type) noexcept { return type.type(); }

void require_same(const AnyType& message, const AnyType& topic) {
  if (message.is_same(topic)) return;
  throw Error(EINVAL, topic.name(), "the message is of another type: " + message.name(),
              "push it on a topic that carries its type, or copy what you need into a loan()");
}

void require_opaque(const AnyType& type) {
  if (type.description().root().kind == Kind::Opaque) return;
  throw Error(EINVAL, type.name(), "the type is not opaque", "build the message by loan()");
}

void refer(const MutableValue& reference, const AnyMessage& target) {
  const Value& place = reference.value();
  if (place.kind() != Kind::Reference) {
    throw Error(EINVAL, place.path(), "it is a " + place.type_name() + ", and no reference",
                "set a reference to a message");
  }
  auto& ref =
      *static_cast<ShmRef<const std::byte>*>(const_cast<void*>(place.address()));  // any ShmRef
  if (!target) return ref.reset();
  const Description wanted =
      description::part(ValueAccess::description(place), place.type().element);
  const std::string difference = description::first_difference(wanted, target.type().description());
  if (!difference.empty()) {
    throw Error(EINVAL, place.path(),
                "the message is of another type, " + target.type().name() + ": " + difference,
                "refer to a " + place.type_name());
  }
  ref = ShmSharedPtr<const std::byte>(target.pointer(),
                                      static_cast<const std::byte*>(target.pointer().get()));
}

MessageMemory memory_of(Arena* arena) noexcept {
  return {arena,
          [](void* its, std::size_t bytes, std::size_t align) {
            return static_cast<Arena*>(its)->allocate(bytes, align);
          },
          [](void* its, void* piece, std::size_t bytes) noexcept {
            static_cast<Arena*>(its)->deallocate(piece, bytes);
          }};
}

Value value_of(const Description& description, const void* message) {
  const Mapping& mapping = mapping_of(message);
  return {description, message, mapping.base(), mapping.base() + mapping.size()};
}

Value borrowed_value_of(const Description& description, const void* message, std::size_t size) {
  if (Mapping::of(message) != nullptr) return value_of(description, message);
  // It was borrowed from its slot: a copy in private memory. It has no pointer in it.
  const auto* const begin = static_cast<const unsigned char*>(message);
  return {description, message, begin, begin + size};
}

MutableValue mutable_value_of(const Description& description, void* message, Arena* arena) {
  const Mapping& mapping = mapping_of(message);
  return {description, message, mapping.base(), mapping.base() + mapping.size(), memory_of(arena)};
}

}  // namespace detail
}  // namespace lot
