// SPDX-License-Identifier: Apache-2.0
#include "description/builder.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include "description/containers.hpp"

namespace lot::description {
namespace {

using Access = detail::ValueAccess;

unsigned char* mine(const unsigned char* at) { return const_cast<unsigned char*>(at); }

void store(const unsigned char* at, std::uint64_t word) { std::memcpy(mine(at), &word, kWord); }

/// Writes a pointer. It is relative to its own place.
void point(const unsigned char* at, const void* to) {
  store(at, to == nullptr
                ? kNull
                : reinterpret_cast<std::uintptr_t>(to) - reinterpret_cast<std::uintptr_t>(at));
}

const VectorWords& words_of(const Description::Type& vector) {
  return is_libcxx(vector.name) ? kLibcxxVector : kStdVector;
}

/// No type wants more than the largest power of two that its size is a multiple of; no page ends
/// within a type.
std::size_t align_for(std::uint64_t size) {
  constexpr std::uint64_t kPage = 4096;
  return std::min(size & (~size + 1), kPage);
}

/// What a long string of libstdc++ has, without its zero.
std::uint64_t std_capacity(const Value& string, const unsigned char* data) {
  const std::uint64_t capacity = Access::word(string, StdString::kCapacity);
  if (!Access::is_inside(string, data, capacity) ||
      !Access::is_inside(string, data, capacity + 1)) {
    Access::damaged(string, "its text does not lie in the segment");
  }
  return capacity;
}

/// What a long string of Boost has, with its zero.
std::uint64_t boost_storage(const Value& string, const unsigned char* data) {
  const std::uint64_t storage = Access::word(string, BoostString::kStorage);
  if (data == nullptr || storage == 0 || !Access::is_inside(string, data, storage)) {
    Access::damaged(string, "its text does not lie in the segment");
  }
  return storage;
}

bool is_short(const Value& boost_string) {
  return (Access::word(boost_string, BoostString::kHead) & 1) != 0;
}

}  // namespace

// ---- which types need what ----

Builder::Needs Builder::needs(const Value& value, std::uint32_t place) {
  constexpr signed char kWords = 1;
  constexpr signed char kOpaque = 2;
  if (needs_.empty()) needs_.assign(all_.types.size(), -1);
  const Type& type = Access::type_at(value, place);
  if (needs_[place] < 0) {
    needs_[place] = 0;  // a type within itself adds nothing
    signed char found = 0;
    const auto add = [&](std::uint32_t part) {
      const Needs its = needs(value, part);
      found =
          static_cast<signed char>(found | (its.words ? kWords : 0) | (its.opaque ? kOpaque : 0));
    };
    if (type.kind == Kind::String || type.kind == Kind::Vector || type.kind == Kind::Reference) {
      found = kWords;
    } else if (type.kind == Kind::Opaque) {
      found = kOpaque;
    } else if (type.kind == Kind::Array) {
      add(type.element);
    } else if (type.kind == Kind::Struct) {
      for (const Description::Field& field : type.fields) add(field.type);
      require_apart(value, type);
    }
    needs_[place] = found;
  }
  return {(needs_[place] & kWords) != 0, (needs_[place] & kOpaque) != 0};
}

/// Fields with containers do not share bytes. So a struct has few of them, and not itself.
void Builder::require_apart(const Value& value, const Type& type) {
  std::vector<std::pair<std::uint64_t, std::uint64_t>> taken;
  for (const Description::Field& field : type.fields) {
    if (needs(value, field.type).words) {
      taken.emplace_back(field.offset, Access::type_at(value, field.type).size);
    }
  }
  std::sort(taken.begin(), taken.end());
  std::uint64_t end = 0;
  for (const auto& [offset, size] : taken) {
    if (offset < end || size > type.size || offset > type.size - size) {
      Access::damaged(value, "its description has fields that share bytes");
    }
    end = offset + size;
  }
}

template <class F>
void Builder::each_container(const Value& value, F&& f) {
  if (!needs(value, Access::place(value)).words) return;
  const Type& type = Access::inside(value);
  if (type.kind == Kind::Struct) {
    for (std::uint64_t i = 0; i < type.fields.size(); ++i) {
      if (needs(value, type.fields[i].type).words) each_container(Access::field(value, type, i), f);
    }
  } else if (type.kind == Kind::Array) {
    const Items items = Access::items(value);
    for (std::uint64_t i = 0; i < items.count; ++i) {
      each_container(Access::item(value, items, i), f);
    }
  } else {
    f(value);
  }
}

// ---- making ----

void Builder::require_makeable(const Value& value, std::uint32_t place) {
  if (needs(value, place).opaque) {
    Access::refuse(
        value, EINVAL,
        "a " + Access::name_of(all_, place, 8) +
            " cannot be made here: only its own programs know how it, or a part of it, begins");
  }
}

void Builder::clear_bits(const Value& value, std::uint32_t bits) {
  unsigned char* const at = mine(Access::address(value));
  for (std::uint32_t bit = Access::bit(value); bits != 0; ++bit, --bits) {
    at[bit / 8] = static_cast<unsigned char>(at[bit / 8] & ~(1U << (bit % 8)));
  }
}

void Builder::construct(const Value& value) {
  const Type& type = Access::inside(value);
  require_makeable(value, Access::place(value));
  if (const std::uint32_t bits = Access::bits(value); bits != 0) return clear_bits(value, bits);
  std::memset(mine(Access::address(value)), 0, type.size);
  each_container(value, [this](const Value& container) { construct_container(container); });
}

void Builder::construct_container(const Value& value) const {
  const Type& type = value.type();
  const unsigned char* const at = Access::address(value);
  if (type.kind == Kind::Vector) {
    const VectorWords& words = words_of(type);
    if (type.size != kVectorSize) Access::damaged(value, "its description is of another size");
    point(at + words.allocator, memory_.arena);
    for (const std::uint64_t word : {words.begin, words.end, words.capacity}) {
      point(at + word, nullptr);
    }
  } else if (type.kind == Kind::Reference) {
    if (type.size != ReferenceWords::kSize) {
      Access::damaged(value, "its description is of another size");
    }
    point(at + ReferenceWords::kAllocator, memory_.arena);
    point(at + ReferenceWords::kTarget, nullptr);
  } else if (is_libcxx(type.name) && type.size == BoostString::kSize) {
    point(at + BoostString::kAllocator, memory_.arena);
    store(at + BoostString::kHead, 1);
  } else if (is_libstdcxx(type.name) && type.size == StdString::kSize) {
    point(at + StdString::kAllocator, memory_.arena);
    point(at + StdString::kData, at + StdString::kLocal);
  } else {
    Access::refuse(value, EINVAL, "it is a string of another library: " + type.name);
  }
}

// ---- vectors ----

std::uint64_t Builder::capacity(const Value& vector, const Items& items) const {
  const unsigned char* const end = Access::follow(vector, words_of(vector.type()).capacity);
  if (items.data == nullptr && end == nullptr) return 0;
  if (items.data == nullptr || end < items.data ||
      static_cast<std::uint64_t>(end - items.data) / items.stride < items.count) {
    Access::damaged(vector, "its memory ends before it begins");
  }
  return static_cast<std::uint64_t>(end - items.data) / items.stride;
}

void Builder::tell(const Value& vector, const Items& items,
                   const unsigned char* end_of_memory) const {
  const VectorWords& words = words_of(vector.type());
  const unsigned char* const at = Access::address(vector);
  point(at + words.begin, items.data);
  point(at + words.end, items.data + items.count * items.stride);
  point(at + words.capacity, end_of_memory);
}

void Builder::resize(const Value& vector, std::uint64_t count, bool zeroed) {
  Items items = Access::items(vector);
  if (vector.kind() == Kind::Array) {
    if (count == items.count) return;
    Access::refuse(vector, EINVAL, "it has " + std::to_string(items.count) + " elements, always");
  }
  const std::uint64_t has = items.count;
  const std::uint64_t room = capacity(vector, items);
  if (count > has) {
    if (zeroed) require_makeable(vector, items.type);
    if (count > room) return grow(vector, items, count, zeroed);
    items.count = count;
    make_items(vector, items, has, zeroed);
  } else {
    for (std::uint64_t i = count; i < has; ++i) {
      require_no_references(Access::item(vector, items, i));
    }
    for (std::uint64_t i = count; i < has; ++i) {
      each_container(Access::item(vector, items, i), [this](const Value& v) { release(v); });
    }
    items.count = count;
  }
  if (items.data != nullptr) tell(vector, items, items.data + room * items.stride);
}

void Builder::grow(const Value& vector, const Items& has, std::uint64_t count, bool zeroed) {
  std::uint64_t bytes = 0;
  if (__builtin_mul_overflow(count, has.stride, &bytes) || bytes > ~std::uint64_t{0} / 2) {
    Access::refuse(vector, ERANGE, "it cannot have " + std::to_string(count) + " elements");
  }
  const std::uint64_t room = capacity(vector, has);
  require_makeable(vector, has.type);  // what is moved, too
  auto* const data =
      static_cast<unsigned char*>(memory_.allocate(memory_.arena, bytes, align_for(has.stride)));
  const Items items{data, count, has.stride, has.type};
  if (has.count != 0) std::memcpy(data, has.data, has.count * has.stride);
  const auto distance =
      reinterpret_cast<std::uintptr_t>(data) - reinterpret_cast<std::uintptr_t>(has.data);
  if (needs(vector, has.type).words) {
    for (std::uint64_t i = 0; i < has.count; ++i) {
      each_container(Access::item(vector, items, i),
                     [&](const Value& container) { moved(container, distance); });
    }
  }
  make_items(vector, items, has.count, zeroed);
  tell(vector, items, data + bytes);
  if (room != 0) give_back(has.data, room * has.stride);
}

void Builder::make_items(const Value& vector, const Items& items, std::uint64_t from, bool zeroed) {
  if (!zeroed || from == items.count) return;
  std::memset(mine(items.data) + from * items.stride, 0, (items.count - from) * items.stride);
  if (!needs(vector, items.type).words) return;
  for (std::uint64_t i = from; i < items.count; ++i) {
    each_container(Access::item(vector, items, i),
                   [this](const Value& container) { construct_container(container); });
  }
}

void Builder::moved(const Value& container, std::uint64_t distance) {
  const Type& type = container.type();
  const unsigned char* const at = Access::address(container);
  const auto correct = [&](std::uint64_t offset) {
    const std::uint64_t word = Access::load<std::uint64_t>(at + offset);
    const std::uint64_t from_begin = offset + word;  // a string's own bytes move with it
    if (word != kNull && from_begin >= type.size) store(at + offset, word - distance);
  };
  if (type.kind == Kind::Vector) {
    for (std::uint64_t offset = 0; offset < kVectorSize; offset += kWord) correct(offset);
  } else if (type.kind == Kind::Reference) {
    correct(ReferenceWords::kAllocator);
    correct(ReferenceWords::kTarget);
  } else if (is_libcxx(type.name)) {
    correct(BoostString::kAllocator);
    if (!is_short(container)) correct(BoostString::kData);
  } else {
    correct(StdString::kAllocator);
    correct(StdString::kData);
  }
}

void Builder::require_no_references(const Value& value) {
  each_container(value, [this](const Value& container) {
    if (looks_left_-- == 0) {  // vectors of a forged message can be the same again and again
      Access::damaged(container, std::to_string(kMostLooks) + " others lie before it");
    }
    const Kind kind = container.kind();
    if (kind == Kind::Reference && !container.is_null()) {
      Access::refuse(container, EINVAL, "a reference cannot be let go here");
    }
    if (kind != Kind::Vector) return;
    const Items items = Access::items(container);
    (void)capacity(container, items);  // that it is not damaged
    if (!needs(container, items.type).words) return;
    for (std::uint64_t i = 0; i < items.count; ++i) {
      require_no_references(Access::item(container, items, i));
    }
  });
}

void Builder::release(const Value& container) {
  const Type& type = container.type();
  if (type.kind == Kind::Vector) {
    const Items items = Access::items(container);
    if (needs(container, items.type).words) {
      for (std::uint64_t i = 0; i < items.count; ++i) {
        each_container(Access::item(container, items, i), [this](const Value& v) { release(v); });
      }
    }
    const std::uint64_t room = capacity(container, items);
    if (room != 0) give_back(items.data, room * items.stride);
  } else if (type.kind == Kind::String && is_libcxx(type.name)) {
    if (is_short(container)) return;
    const unsigned char* const data = Access::follow(container, BoostString::kData);
    give_back(data, boost_storage(container, data));
  } else if (type.kind == Kind::String) {
    const unsigned char* const data = Access::follow(container, StdString::kData);
    if (data == Access::address(container) + StdString::kLocal) return;
    give_back(data, std_capacity(container, data) + 1);
  }
}

// ---- strings ----

void Builder::set_text(const Value& string, std::string_view text) {
  (void)Access::text(string);  // that it is not damaged, and of a library that is known
  if (is_libcxx(string.type().name)) {
    set_boost_text(string, text);
  } else {
    set_std_text(string, text);
  }
}

void Builder::set_std_text(const Value& string, std::string_view text) const {
  const unsigned char* const at = Access::address(string);
  const unsigned char* data = Access::follow(string, StdString::kData);
  if (data == nullptr) Access::damaged(string, "its text does not lie in the segment");
  const bool is_local = data == at + StdString::kLocal;
  const std::uint64_t room = is_local ? StdString::kMostLocal : std_capacity(string, data);
  if (text.size() > room) {
    const unsigned char* const before = data;
    data = copy_of(text);
    if (!is_local) give_back(before, room + 1);
    point(at + StdString::kData, data);
    store(at + StdString::kCapacity, text.size());
  } else {
    if (!text.empty()) std::memmove(mine(data), text.data(), text.size());
    *mine(data + text.size()) = 0;
  }
  store(at + StdString::kLength, text.size());
}

void Builder::set_boost_text(const Value& string, std::string_view text) const {
  const unsigned char* const at = Access::address(string);
  const bool was_short = is_short(string);
  const unsigned char* data =
      was_short ? at + BoostString::kLocal : Access::follow(string, BoostString::kData);
  const std::uint64_t storage =
      was_short ? BoostString::kMostLocal + 1 : boost_storage(string, data);
  const bool grows = text.size() > storage - 1;
  if (grows) {
    const unsigned char* const before = data;
    data = copy_of(text);
    if (!was_short) give_back(before, storage);
    store(at + BoostString::kStorage, text.size() + 1);
    point(at + BoostString::kData, data);
  } else {
    if (!text.empty()) std::memmove(mine(data), text.data(), text.size());
    *mine(data + text.size()) = 0;
  }
  if (was_short && !grows) {
    *mine(at + BoostString::kHead) = static_cast<unsigned char>(text.size() << 1 | 1);
  } else {
    store(at + BoostString::kHead, text.size() << 1);
  }
}

/// The text and a zero behind it, in memory of the message.
unsigned char* Builder::copy_of(std::string_view text) const {
  auto* const data =
      static_cast<unsigned char*>(memory_.allocate(memory_.arena, text.size() + 1, 1));
  std::memcpy(data, text.data(), text.size());
  data[text.size()] = 0;
  return data;
}

void Builder::give_back(const unsigned char* piece, std::uint64_t bytes) const noexcept {
  memory_.deallocate(memory_.arena, mine(piece), bytes);
}

}  // namespace lot::description
