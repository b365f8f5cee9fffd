// SPDX-License-Identifier: Apache-2.0
#include "codec/program.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <string>
#include <type_traits>
#include <utility>

#include "lot/error.hpp"

#include "codec/kinds.hpp"
#include "description/containers.hpp"
#include "description/reader.hpp"
#include "description/wire.hpp"

namespace lot::codec {
namespace {

using Type = Description::Type;

/// The steps of a message or of an element, and what others must know of them.
struct Body {
  std::vector<Step> steps;
  std::uint64_t least = 0;  ///< bytes of CDR
  bool needs_value = false;
};

std::uint64_t saturated_product(std::uint64_t a, std::uint64_t b) {
  std::uint64_t product = 0;
  return __builtin_mul_overflow(a, b, &product) ? ~std::uint64_t{0} : product;
}
std::uint64_t saturated_sum(std::uint64_t a, std::uint64_t b) {
  std::uint64_t sum = 0;
  return __builtin_add_overflow(a, b, &sum) ? ~std::uint64_t{0} : sum;
}

/// Makes the steps of one description.
class Compiler {
 public:
  Compiler(const Description& all, std::vector<std::uint32_t>& ways) : all_(all), ways_(ways) {}

  Body body_of(std::uint32_t place) {
    std::vector<std::uint32_t> outer = std::exchange(way_, {});
    Body body;
    add(body, place, 0);
    way_ = std::move(outer);
    require_apart(body.steps);
    body.steps = joined(body.steps);
    return body;
  }

 private:
  [[noreturn]] void refuse(int error, const std::string& what, const std::string& advice = "") {
    throw Error(error, path_.empty() ? "message" : path_, what, advice);
  }
  [[noreturn]] void contradiction(const std::string& what) {
    refuse(EBADMSG, "its description " + what);
  }
  const Type& type_at(std::uint32_t place) {
    if (place >= all_.types.size()) contradiction("names a type that is not there");
    return all_.types[place];
  }

  /// Adds the steps of a type that lies at the offset.
  void add(Body& body, std::uint32_t place, std::uint64_t offset) {
    const Type& type = type_at(place);
    if (++parts_ > description::kMostSteps) refuse(EINVAL, "it has too many parts");
    if (std::find(open_.begin(), open_.end(), place) != open_.end()) {
      refuse(EINVAL, type.name + " lies within itself, which no type of ROS 2 does");
    }
    if (open_.size() == description::kMostLevels) refuse(EINVAL, "it lies too deep");
    open_.push_back(place);
    switch (type.kind) {
      case Kind::Struct:
        add_struct(body, type, offset);
        break;
      case Kind::Array:
        add_array(body, type, offset);
        break;
      case Kind::Vector:
        add_vector(body, type, offset);
        break;
      case Kind::String:
        add_text(body, type, offset);
        break;
      case Kind::Reference:
        refuse(EINVAL, "it leads to another message, which has bytes of its own");
      case Kind::Opaque:
        refuse(EINVAL, "a " + type.name + " is known only to its own programs");
      default:
        add_number(body, type, offset);
    }
    open_.pop_back();
  }

  void push(Body& body, const Step& step, std::uint64_t least) {
    body.steps.push_back(step);
    body.least = saturated_sum(body.least, least);
    body.needs_value |= step.needs_value;
  }
  /// A step that needs a Value, and so the way there.
  Step placed(Do what, std::uint64_t offset) {
    Step step;
    step.what = what;
    step.offset = offset;
    step.needs_value = true;
    step.way = static_cast<std::uint32_t>(ways_.size());
    step.way_size = static_cast<std::uint32_t>(way_.size());
    ways_.insert(ways_.end(), way_.begin(), way_.end());
    return step;
  }

  // ---- numbers and texts ----

  const Type& number(const Type& type) {
    const Type* const its = number_of(all_, type);
    if (its == nullptr) contradiction("has a number that is none");
    const bool is_known = its->kind == Kind::Float
                              ? its->size == 4 || its->size == 8
                              : its->size <= 8 && std::has_single_bit(its->size);
    if (!is_known) {
      refuse(EINVAL, "ROS 2 has no number of " + std::to_string(its->size) + " bytes like it");
    }
    if (its->kind == Kind::Bool && its->size != 1) contradiction("has a bool of many bytes");
    return *its;
  }

  void add_number(Body& body, const Type& type, std::uint64_t offset) {
    const Type& its = number(type);
    Step step;
    step.what = its.kind == Kind::Bool ? Do::Bools : Do::Numbers;
    step.align = static_cast<std::uint8_t>(its.size);
    step.offset = offset;
    step.count = 1;
    push(body, step, its.size);
  }

  void add_bits(Body& body, const Description::Field& field, std::uint64_t offset) {
    const Type& its = number(type_at(field.type));
    if (its.kind == Kind::Float || field.bits > 8 * its.size)
      contradiction("has bits of no number");
    Step step = placed(Do::Bits, offset);
    step.align = static_cast<std::uint8_t>(its.size);
    step.count = its.size;
    step.stride = (std::uint64_t{field.bit} + field.bits + 7) / 8;
    step.is_signed = its.kind == Kind::Int || (its.kind == Kind::Char && std::is_signed_v<char>);
    push(body, step, its.size);
  }

  void add_text(Body& body, const Type& type, std::uint64_t offset) {
    const bool is_known =
        description::is_libstdcxx(type.name)
            ? type.size == description::StdString::kSize
            : description::is_libcxx(type.name) && type.size == description::BoostString::kSize;
    if (!is_known) refuse(EINVAL, "it is a string of another library: " + type.name);
    Step step = placed(Do::Text, offset);
    step.stride = type.size;
    push(body, step, 4);
  }

  // ---- what has parts ----

  void add_struct(Body& body, const Type& type, std::uint64_t offset) {
    const std::size_t first = body.steps.size();
    for (std::uint32_t i = 0; i < type.fields.size(); ++i) {
      const Description::Field& field = type.fields[i];
      const std::size_t outer = path_.size();
      path_ += (outer == 0 ? "" : ".") + detail::name_of_field(type, i);
      const std::uint64_t bytes = field.bits == 0 ? type_at(field.type).size
                                                  : (std::uint64_t{field.bit} + field.bits + 7) / 8;
      if (field.offset > type.size || bytes > type.size - field.offset || field.bits > 64 ||
          field.bit > 7) {
        contradiction("has a field outside of the struct");
      }
      way_.push_back(i);
      if (field.bits != 0) {
        add_bits(body, field, offset + field.offset);
      } else if (i == 0 && is_ros_header(all_, type)) {
        Step step;
        step.what = Do::Clear;
        step.offset = offset + field.offset;
        step.count = bytes;
        push(body, step, 0);
      } else {
        add(body, field.type, offset + field.offset);
      }
      way_.pop_back();
      path_.resize(outer);
    }
    if (body.steps.size() != first) return;
    Step step;
    step.what = Do::Blank;
    step.offset = offset;
    push(body, step, 1);
  }

  Body elements(const Type& type, Step& step) {
    const Type& element = type_at(type.element);
    if (element.size == 0) contradiction("has elements without a size");
    const std::size_t outer = path_.size();
    path_ += "[]";
    Body body = body_of(type.element);
    path_.resize(outer);
    step.stride = element.size;
    step.least = body.least;
    step.body = static_cast<std::uint32_t>(body.steps.size());
    const Step& first = body.steps.front();
    const std::uint64_t bytes = first.what == Do::Run ? first.count : first.count * first.align;
    const bool is_all = first.what == Do::Run ? first.body + 1 == step.body : step.body == 1;
    if ((first.what == Do::Run || first.what == Do::Numbers) && is_all && first.offset == 0 &&
        bytes == element.size) {
      const std::uint8_t widest = first.what == Do::Run ? first.widest : first.align;
      step.align = first.align;
      if (element.size % widest == 0) step.widest = widest;
    }
    return body;
  }

  void add_array(Body& body, const Type& type, std::uint64_t offset) {
    Step step = placed(Do::Each, offset);
    const Body its = elements(type, step);
    if (type.count == 0 || type.count > type.size / step.stride) {
      contradiction("has more elements than fit, or none");
    }
    step.count = type.count;
    step.needs_value = its.needs_value;
    const Step& first = its.steps.front();
    const bool is_flat = its.steps.size() == 1 && first.offset == 0 &&
                         ((first.what == Do::Numbers && step.widest != 0) ||
                          (first.what == Do::Bools && first.count == step.stride));
    if (is_flat) {  // an array of numbers, or of arrays of them
      Step flat = first;
      flat.offset = offset;
      flat.count = first.count * type.count;
      return push(body, flat, flat.count * flat.align);
    }
    push(body, step, saturated_product(its.least, type.count));
    body.steps.insert(body.steps.end(), its.steps.begin(), its.steps.end());
  }

  void add_vector(Body& body, const Type& type, std::uint64_t offset) {
    if (type.size != description::kVectorSize ||
        !(description::is_libcxx(type.name) || description::is_libstdcxx(type.name))) {
      refuse(EINVAL, "it is a vector of another library: " + type.name);
    }
    Step step = placed(Do::Items, offset);
    const Body its = elements(type, step);
    push(body, step, 4);
    body.steps.insert(body.steps.end(), its.steps.begin(), its.steps.end());
  }

  // ---- the steps of one body ----

  static std::uint64_t bytes_of(const Step& step) {
    switch (step.what) {
      case Do::Numbers:
      case Do::Bools:
        return step.count * step.align;
      case Do::Clear:
        return step.count;
      case Do::Each:
        return step.count * step.stride;
      case Do::Items:
        return description::kVectorSize;
      case Do::Bits:
      case Do::Text:
        return step.stride;
      default:
        return 0;  // Blank: an empty struct may lie anywhere
    }
  }

  /// A decoder writes one step after the other: none may write where another has built something.
  /// Bit-fields share bytes among themselves.
  void require_apart(const std::vector<Step>& steps) {
    struct Place {
      std::uint64_t begin;
      std::uint64_t end;
      bool is_bits;
    };
    std::vector<Place> taken;
    for (std::size_t i = 0; i < steps.size(); i += 1 + steps[i].body) {
      const std::uint64_t bytes = bytes_of(steps[i]);
      const std::uint64_t begin = steps[i].offset;
      if (bytes != 0) taken.push_back({begin, begin + bytes, steps[i].what == Do::Bits});
    }
    std::sort(taken.begin(), taken.end(),
              [](const Place& a, const Place& b) { return a.begin < b.begin; });
    std::uint64_t end = 0;          // of what comes before
    std::uint64_t end_of_bits = 0;  // the same of bit-fields
    for (const Place& place : taken) {
      if (place.begin < end || (!place.is_bits && place.begin < end_of_bits)) {
        contradiction("has fields that share bytes");
      }
      std::uint64_t& its = place.is_bits ? end_of_bits : end;
      its = std::max(its, place.end);
    }
  }

  /// Whether two steps are one: numbers of one size, or bools, side by side.
  static bool are_one(const Step& first, const Step& second) {
    return first.what == second.what && first.align == second.align &&
           (first.what == Do::Numbers || first.what == Do::Bools) &&
           first.offset + bytes_of(first) == second.offset;
  }
  static std::vector<Step> merged(const std::vector<Step>& steps) {
    std::vector<Step> result;
    bool may_grow = false;  // the last one is no part of a body
    for (std::size_t i = 0; i < steps.size(); i += 1 + steps[i].body) {
      if (may_grow && are_one(result.back(), steps[i])) {
        result.back().count += steps[i].count;
        continue;
      }
      const auto from = steps.begin() + static_cast<std::ptrdiff_t>(i);
      result.insert(result.end(), from, from + 1 + steps[i].body);
      may_grow = steps[i].body == 0;
    }
    return result;
  }

  /// Whether the numbers of a step may be part of a run.
  static bool is_aligned(const Step& step) {
    return step.what == Do::Numbers && step.offset % step.align == 0;
  }
  /// Joins numbers that lie side by side: of one size to one step, of several sizes to a run.
  static std::vector<Step> joined(const std::vector<Step>& all) {
    const std::vector<Step> steps = merged(all);
    std::vector<Step> result;
    for (std::size_t i = 0; i < steps.size();) {
      Step run;
      run.what = Do::Run;
      run.align = steps[i].align;
      run.offset = steps[i].offset;
      std::size_t end = i;
      while (end < steps.size() && is_aligned(steps[end]) &&
             steps[end].offset == run.offset + run.count) {
        run.widest = std::max(run.widest, steps[end].align);
        run.count += bytes_of(steps[end++]);
      }
      run.body = static_cast<std::uint32_t>(end - i);
      if (run.body > 1) result.push_back(run);
      const std::size_t next = std::max(end, i + 1 + steps[i].body);
      result.insert(result.end(), steps.begin() + static_cast<std::ptrdiff_t>(i),
                    steps.begin() + static_cast<std::ptrdiff_t>(next));
      i = next;
    }
    return result;
  }

  const Description& all_;
  std::vector<std::uint32_t>& ways_;
  std::vector<std::uint32_t> way_;   ///< the fields from the body's value to the part
  std::vector<std::uint32_t> open_;  ///< the types that this one lies in
  std::string path_;                 ///< of the part, for people
  std::size_t parts_ = 0;
};

}  // namespace

Program::Program(const Description& description) : description_(&description) {
  if (std::endian::native != std::endian::little) {
    throw Error(ENOTSUP, "message", "this machine is big-endian, and the codec is not", "");
  }
  steps_ = Compiler(description, ways_).body_of(0).steps;
}

void Program::require(const Value& message) const {
  using Access = detail::ValueAccess;
  if (&Access::description(message) != description_ || Access::place(message) != 0) {
    Access::refuse(message, EINVAL, "it is not of the type that the codec was made for");
  }
  (void)Access::inside(message);
}

}  // namespace lot::codec
