// SPDX-License-Identifier: Apache-2.0
#include "registry/known_type.hpp"

#include <atomic>
#include <bit>
#include <cerrno>
#include <tuple>
#include <utility>

#include "lot/compliance.hpp"
#include "lot/error.hpp"

#include "description/wire.hpp"

namespace lot::registry {
namespace {

Description opaque(std::string name, std::uint64_t size) {
  Description::Type type;
  type.size = size;
  type.name = std::move(name);
  Description description;
  description.types.push_back(std::move(type));
  return description;
}

}  // namespace

KnownType::KnownType(std::string name, const segment::TopicEntry& topic,
                     const std::optional<std::string>& bytes)
    : name_(std::move(name)) {
  if (!std::has_single_bit(topic.type_align) || topic.type_align > detail::kMaxAlignment) {
    throw Error(EBADMSG, name_,
                "the segment says nonsense of this type: its alignment is " +
                    std::to_string(topic.type_align),
                "end the process that writes where it should not");
  }
  fill(topic.type_size, topic.type_align, topic.type_hash);
  // A layout of 0: the topic's users have a type without a description.
  if (topic.type_layout != 0) {
    const std::uint64_t names = topic.type_names.load(std::memory_order_relaxed);  // the lock
    describe({topic.type_layout, names, false, bytes.value_or("")});
  }
  if (!bytes) return;
  description_ = bytes->empty() ? opaque(name_, type_.size) : description::decode(*bytes);
  if (description_ && description_->root().size != type_.size) description_.reset();
  if (!description_) return;
  type_.known.has_names = description::has_names(*description_);
  // A process was killed after it had described the type with all names, before their hash.
  if (type_.known.names == 0) type_.known.names = description_->names_hash();
}

KnownType::KnownType(const detail::MessageType& type, Description description)
    : name_(type.name), description_(std::move(description)) {
  fill(type.size, type.align, type.hash);
  if (type.described != nullptr) describe(type.described(type));
}

KnownType::KnownType(std::string name, std::uint64_t align, std::uint64_t hash,
                     Description description)
    : name_(std::move(name)), description_(std::move(description)) {
  fill(description_->root().size, align, hash);
  describe(detail::make_described(*description_));
}

KnownType::KnownType(std::string name, const KnownType& item)
    : name_(std::move(name)), description_(item.description_) {
  const std::uint64_t hash = item.type_.hash;
  fill(item.type_.size, item.type_.align, hash != 0 ? ~hash : 0);  // as detail::taken_type()
  if (item.type_.described != nullptr) describe(item.type_.known);
  type_.element = &item.type_;
}

void KnownType::fill(std::uint64_t size, std::uint64_t align, std::uint64_t hash) noexcept {
  type_.size = size;
  type_.align = align;
  type_.hash = hash;
  type_.name = name_.c_str();
}

void KnownType::describe(detail::Described known) {
  type_.known = std::move(known);
  type_.described = [](const detail::MessageType& type) -> const detail::Described& {
    return static_cast<const Type&>(type).known;
  };
}

const Description& KnownType::description() const {
  if (!description_) {
    throw Error(EBADMSG, name_, "the description of this type is damaged",
                "end the process that writes where it should not; the topic's ends may go on");
  }
  return *description_;
}

bool KnownType::is_equal(const KnownType& other) const noexcept {
  const auto all = [](const KnownType& t) {
    return std::tie(t.name_, t.type_.size, t.type_.align, t.type_.hash, t.type_.known.layout,
                    t.type_.known.names, t.type_.known.bytes);
  };
  return all(*this) == all(other) && description_.has_value() == other.description_.has_value();
}

}  // namespace lot::registry
