// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>

#include "lot/description.hpp"

/// Descriptions that are put together of others, and taken apart.
namespace lot::description {

/// The type at that place, and all that it is made of. REQUIRES: the places in it are right. Throws
/// std::bad_alloc.
Description part(const Description& all, std::uint32_t place);

/// How the compiler aligns the type at that place: of an opaque one as if it were a number. Of what
/// a compiler was told to pack it says too much. REQUIRES: decode() would take it. Throws nothing.
std::uint64_t natural_alignment(const Description& all, std::uint32_t place) noexcept;

/// Builds the description of a type of others. Its own place is the first one; equal parts are
/// there once, as those that the compiler describes.
class Composer {
 public:
  Composer() { result_.types.emplace_back(); }
  /// The place of another description's type. Throws std::bad_alloc.
  std::uint32_t add(const Description& whole) { return add(whole, 0); }
  /// REQUIRES: the places in it came from add().
  Description take(Description::Type own) && {
    result_.types.front() = std::move(own);
    return std::move(result_);
  }

 private:
  std::uint32_t add(const Description& all, std::uint32_t place);

  Description result_;
  std::map<std::string, std::uint32_t> places_;  ///< by the bytes of what lies there
};

}  // namespace lot::description
