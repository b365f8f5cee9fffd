// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>

#include "lot/any_message.hpp"

#include "codec/program.hpp"
#include "codec/schema.hpp"
#include "mcap/records.hpp"

namespace lot::record {

/// What a topic of a segment is called in a file: lot::ros puts the name of the ROS graph in front
/// of ROS's name, which a file does not have.
std::string name_in_file(const std::string& topic);

/// A topic, as long as it carries one type, and how its messages become bytes.
///
/// Threads: any number may use one.
struct Stream {
  /// `line`: its place in the Ledger. Throws lot::Error: EINVAL, EBADMSG for a type that the codec
  /// does not take.
  Stream(const std::string& topic, const AnyType& its_type)
      : name(name_in_file(topic)),
        type(its_type),
        program(type.description()),
        schema(codec::schema_of(type.description())) {}
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  std::string name;
  AnyType type;
  codec::Program program;  ///< of the type's description
  codec::Schema schema;
  mcap::Pairs metadata;  ///< of its channel
  std::size_t line = 0;  ///< its place in the Ledger
};

}  // namespace lot::record
