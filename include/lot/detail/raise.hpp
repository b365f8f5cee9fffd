// SPDX-License-Identifier: Apache-2.0
#pragma once

/// What the templates of the public headers throw. The library throws it, so that a program which
/// is compiled without exceptions can include the headers: there each error ends the process, and
/// std::terminate() prints what it says.
namespace lot::detail {

/// Throws std::bad_alloc: a container asks for more memory than there can be.
[[noreturn]] void raise_too_large();
/// Throws std::bad_weak_ptr: the message of a weak pointer has died.
[[noreturn]] void raise_expired();
/// Throws lot::Error (EINVAL): items of type `name`, which each reader gets, cannot be redelivered.
[[noreturn]] void raise_not_redelivered(const char* name);

}  // namespace lot::detail
