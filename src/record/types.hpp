// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "lot/any_message.hpp"

#include "mcap/records.hpp"

/// Types of topics, as the channels of a file say them (docs/record.md).
namespace lot::record {

/// The metadata of a channel whose messages are of that type. Throws std::bad_alloc.
mcap::Pairs pairs_of(const AnyType& type);
/// The type that such metadata names. None: it names none. Throws lot::Error (EBADMSG) for what can
/// be no type: a file may say anything.
AnyType type_of(const mcap::Pairs& pairs);

/// A type for messages of a schema that others have written, as a `.msg` of ROS 2 with the types in
/// it behind lines of `=`. Its name is the schema's. Throws lot::Error: EINVAL for a text that is
/// none, with its line, and for types that no message of LOT can have.
AnyType type_of_schema(const std::string& name, const std::string& text);
/// Whether messages of the type have the fields that the schema says, as are_alike(): false for a
/// type that the codec does not take. Throws std::bad_alloc.
bool is_like(const AnyType& type, const std::string& schema);
/// Whether messages of both have the same fields in the same order, to any depth: then they have
/// the same bytes. Names of types do not count. Both are `.msg`; one that cannot be read is the
/// same as itself alone. Throws std::bad_alloc.
bool are_alike(const std::string& one, const std::string& other);

}  // namespace lot::record
