// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::testing {

/// A sanitizer is built in, which maps terabytes: a limit of address space ends the process.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kMapsTerabytes = true;
#elif defined(__has_feature)
inline constexpr bool kMapsTerabytes =
    __has_feature(address_sanitizer) || __has_feature(thread_sanitizer);
#else
inline constexpr bool kMapsTerabytes = false;
#endif

}  // namespace lot::testing
