// SPDX-License-Identifier: Apache-2.0
#include "tool/message_bytes.hpp"

#include <algorithm>
#include <cerrno>
#include <string>
#include <string_view>

#include "description/reader.hpp"
#include "segment/layout.hpp"

namespace lot::tool {
namespace {

/// The types that a value of a type holds in its own bytes, or in its vectors.
std::vector<std::uint32_t> held_by(const Description::Type& type) {
  std::vector<std::uint32_t> held;
  if (type.kind == Kind::Struct) {
    for (const auto& field : type.fields) held.push_back(field.type);
  } else if (type.kind == Kind::Array || type.kind == Kind::Vector) {
    held.push_back(type.element);
  }
  return held;
}

}  // namespace

std::uint64_t bytes_by_memory(std::uint64_t memory, std::uint64_t type_size) {
  const std::uint64_t granules = type_size / segment::kGranule + 1;
  const bool is_small = type_size <= segment::kSmallBytes;
  const bool is_type_alone = is_small
                                 ? memory == segment::kSmallBytes
                                 : memory > type_size && memory <= granules * segment::kGranule;
  return is_type_alone && type_size != 0 ? type_size : memory;
}

MessageBytes::MessageBytes(const Description& description, std::uint64_t most)
    : all_(&description), most_(most), size_(description.root().size) {
  const auto& types = description.types;
  std::vector<bool> is_part(types.size(), false);  // of the message, but for references
  std::vector<std::uint32_t> open{0};
  while (!open.empty()) {
    const std::uint32_t next = open.back();
    open.pop_back();
    if (next >= types.size() || is_part[next]) continue;
    is_part[next] = true;
    is_exact_ = is_exact_ && types[next].kind != Kind::Opaque;
    for (const std::uint32_t type : held_by(types[next])) open.push_back(type);
  }
  grows_.assign(types.size(), false);
  for (bool has_changed = true; has_changed;) {
    has_changed = false;
    for (std::size_t i = 0; i < types.size(); ++i) {
      if (grows_[i]) continue;
      const auto held = held_by(types[i]);
      grows_[i] = types[i].kind == Kind::String || types[i].kind == Kind::Vector ||
                  std::any_of(held.begin(), held.end(), [this](std::uint32_t type) {
                    return type < grows_.size() && grows_[type];
                  });
      has_changed = has_changed || grows_[i];
    }
  }
}

std::uint64_t MessageBytes::of(const Value& message) const {
  std::uint64_t left = most_;
  return size_ + (is_constant() ? 0 : beside(message, 0, left));
}

/// What a value of that type holds beside its own bytes. `left`: so many more are looked at.
/// REQUIRES: it may hold something.
std::uint64_t MessageBytes::beside(const Value& value, std::uint32_t type,
                                   std::uint64_t& left) const {
  if (left-- == 0) {
    detail::ValueAccess::refuse(value, EBADMSG,
                                std::to_string(most_) + " vectors and strings lie before it");
  }
  const Description::Type& its = all_->types[type];
  std::uint64_t sum = 0;
  if (its.kind == Kind::Struct) {
    for (std::size_t i = 0; i < its.fields.size(); ++i) {
      if (grows_[its.fields[i].type]) sum += beside(value[i], its.fields[i].type, left);
    }
    return sum;
  }
  if (its.kind == Kind::String) {
    const auto text = value.as<std::string_view>();
    const auto distance = reinterpret_cast<std::uintptr_t>(text.data()) -
                          reinterpret_cast<std::uintptr_t>(value.address());
    return distance < its.size ? 0 : text.size();
  }
  const std::size_t elements = value.size();
  if (its.kind == Kind::Vector) sum = elements * all_->types[its.element].size;
  if (grows_[its.element]) {
    for (std::size_t i = 0; i < elements; ++i) sum += beside(value[i], its.element, left);
  }
  return sum;
}

}  // namespace lot::tool
