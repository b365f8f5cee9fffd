// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace ab {

/// What git said of the tree when this was built; "unknown" where it was no checkout.
const char* revision();

}  // namespace ab
