// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>

#include "lot/description.hpp"

namespace lot::tool {

/// The place of the type of what a path names ("labels[2].name", as Value::at()
/// takes it), which messages of the type have where vectors are long enough, and references lead to
/// something. Throws lot::Error: EINVAL where none can have it, EBADMSG where the description is
/// damaged.
std::uint32_t type_at(const Description& description, std::string_view path);

}  // namespace lot::tool
