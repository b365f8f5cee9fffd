// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "lot/mutable_value.hpp"
#include "lot/value.hpp"

#include "codec/program.hpp"

namespace lot::codec {

/// Makes a message what the bytes say, which may have come from anywhere.
///
///     lot::AnyLoan loan = pusher.loan();
///     decode(program, bytes, loan.root());
///
/// Throws lot::Error: EINVAL for a message of another description; ENOTSUP for another encoding
/// than XCDR1 in little-endian order; EBADMSG for bytes that end too early or too late, a text
/// without its zero and a bool that is neither 0 nor 1; ERANGE for what does not fit a bit-field;
/// and what MutableValue::resize() throws. Then the message is half made. It takes no more memory
/// than the bytes, times a number that follows from the type.
void decode(const Program& program, Bytes bytes, const MutableValue& message);

}  // namespace lot::codec
