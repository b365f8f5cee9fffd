// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <cstddef>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "lot/any_type.hpp"

#include "c_interface/errors.hpp"
#include "c_interface/handles.hpp"

namespace lot::c_interface {
namespace {

static_assert(LOT_KIND_OPAQUE == static_cast<int>(Kind::Opaque));
static_assert(LOT_KIND_FLOAT == static_cast<int>(Kind::Float));
static_assert(LOT_KIND_STRUCT == static_cast<int>(Kind::Struct));
static_assert(LOT_KIND_REFERENCE == static_cast<int>(Kind::Reference));

/// Makes a handle of what make() returns.
template <class F>
int give(lot_type** type, F&& make) {
  return guarded([&] {
    require(type, "type");
    *type = new lot_type(make());
    return LOT_OK;
  });
}

const AnyType& of(const lot_type* type, const char* name) {
  require(type, name);
  return type->type;
}

const Description::Type& root(const lot_type* type) {
  return of(type, "type").description().root();
}

}  // namespace
}  // namespace lot::c_interface

using lot::AnyType;
using lot::c_interface::give;
using lot::c_interface::guarded;
using lot::c_interface::of;
using lot::c_interface::require;
using lot::c_interface::root;
using lot::c_interface::text_of;

extern "C" {

// ---- types that are made ----

int lot_type_number(lot_kind kind, size_t size, lot_type** type) {
  return give(type, [&] { return AnyType::number(static_cast<lot::Kind>(kind), size); });
}

int lot_type_string(lot_type** type) {
  return give(type, [] { return AnyType::string(); });
}

int lot_type_vector(const lot_type* element, lot_type** type) {
  return give(type, [&] { return AnyType::vector(of(element, "element")); });
}

int lot_type_array(const lot_type* element, size_t count, lot_type** type) {
  return give(type, [&] { return AnyType::array(of(element, "element"), count); });
}

int lot_type_reference(const lot_type* target, lot_type** type) {
  return give(type, [&] { return AnyType::reference(of(target, "target")); });
}

int lot_type_enum(const char* name, const lot_type* number, lot_type** type) {
  return give(type, [&] {
    return AnyType::enumeration(std::string(text_of(name, "name")), of(number, "number"));
  });
}

int lot_type_duration(const lot_type* number, int64_t numerator, int64_t denominator,
                      lot_type** type) {
  return give(type,
              [&] { return AnyType::duration(of(number, "number"), numerator, denominator); });
}

int lot_type_time_point(const char* clock, const lot_type* duration, lot_type** type) {
  return give(type, [&] {
    return AnyType::time_point(std::string(text_of(clock, "clock")), of(duration, "duration"));
  });
}

int lot_type_struct(const char* name, const lot_field* fields, size_t count, lot_type** type) {
  return give(type, [&] {
    if (count != 0) require(fields, "fields");
    std::vector<AnyType::Field> parts;
    for (size_t i = 0; i < count; ++i) {
      const char* const its_name = fields[i].name;
      parts.push_back({its_name == nullptr ? "" : its_name, of(fields[i].type, "fields")});
    }
    return AnyType::structure(std::string(text_of(name, "name")), parts);
  });
}

int lot_type_opaque(const char* name, size_t size, size_t alignment, lot_type** type) {
  return give(type,
              [&] { return AnyType::opaque(std::string(text_of(name, "name")), size, alignment); });
}

int lot_type_decode(const char* name, size_t alignment, lot_view bytes, uint64_t hash,
                    lot_type** type) {
  return give(type, [&] {
    require(bytes.data, "bytes");
    return AnyType::decoded(std::string(text_of(name, "name")), alignment,
                            {static_cast<const char*>(bytes.data), bytes.size}, hash);
  });
}

int lot_type_of_topic(lot_engine* engine, const char* topic, lot_type** type) {
  return give(type, [&] {
    require(engine, "engine");
    AnyType found = engine->engine.type_of(text_of(topic, "topic"));
    if (!found) {
      throw lot::Error(ENOENT, topic, "no process uses this topic",
                       "ask when a publisher or a subscriber is there");
    }
    return found;
  });
}

int lot_type_copy(const lot_type* type, lot_type** copy) {
  return give(copy, [&] { return of(type, "type"); });
}

void lot_type_release(lot_type* type) { delete type; }

// ---- what a type is ----

const char* lot_type_name(const lot_type* type) { return type->type.name().c_str(); }
size_t lot_type_size(const lot_type* type) { return type->type.size(); }
size_t lot_type_alignment(const lot_type* type) { return type->type.alignment(); }

int lot_type_is_same(const lot_type* a, const lot_type* b, bool* is_same) {
  return guarded([&] {
    require(is_same, "is_same");
    *is_same = of(a, "a").is_same(of(b, "b"));
    return LOT_OK;
  });
}

int lot_type_kind(const lot_type* type, lot_kind* kind) {
  return guarded([&] {
    require(kind, "kind");
    *kind = static_cast<lot_kind>(root(type).kind);
    return LOT_OK;
  });
}

int lot_type_hashes(const lot_type* type, uint64_t* layout, uint64_t* names) {
  return guarded([&] {
    require(layout, "layout");
    require(names, "names");
    const lot::Description& description = of(type, "type").description();
    const auto hash = description.layout_hash();
    *names = description.names_hash();
    *layout = hash;
    return LOT_OK;
  });
}

int lot_type_count(const lot_type* type, size_t* count) {
  return guarded([&] {
    require(count, "count");
    const auto& its = root(type);
    *count = its.kind == lot::Kind::Struct ? its.fields.size() : its.count;
    return LOT_OK;
  });
}

int lot_type_field(const lot_type* whole, size_t place, const char** name, size_t* offset,
                   lot_type** type) {
  return guarded([&] {
    const AnyType its = of(whole, "whole").field(place);
    const auto& field = root(whole).fields[place];
    if (type != nullptr) *type = new lot_type(its);
    if (name != nullptr) *name = field.name.c_str();
    if (offset != nullptr) *offset = field.offset;
    return LOT_OK;
  });
}

int lot_type_element(const lot_type* type, lot_type** element) {
  return give(element, [&] {
    AnyType its = of(type, "type").element();
    if (!its) {
      throw lot::Error(EINVAL, type->type.name(), "this type has no element",
                       "ask arrays, vectors, references, enums, durations and time points");
    }
    return its;
  });
}

int lot_type_encode(const lot_type* type, lot_view* bytes) {
  return guarded([&] {
    require(type, "type");
    require(bytes, "bytes");
    // It is made when it is asked for: most types never are.
    auto* const its = const_cast<lot_type*>(type);
    std::call_once(its->is_encoded, [its] { its->bytes = its->type.encoded(); });
    *bytes = {its->bytes.data(), its->bytes.size()};
    return LOT_OK;
  });
}

}  // extern "C"
