// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "mcap/writer.hpp"
#include "support/scratch.hpp"

/// Recordings of another program, for the tests of lot info and lot play.
namespace lot::testing {

/// How a topic's messages are said to be.
struct Said {
  std::string encoding;
  std::string schema_encoding;  ///< empty: it has no schema
  std::string schema;
};
inline const Said kCount{"cdr", "ros2msg", "uint64 n\n"};

/// A file with messages of each topic at these log times, in nanoseconds. The n of a message is its
/// place among them, from 1.
inline std::string file_of_others(
    const Directory& directory, const std::map<std::string, Said>& topics,
    const std::vector<std::uint64_t>& times = {1'000'000'000, 2'000'000'000, 3'000'000'000},
    const std::string& name = "others.mcap") {
  const std::string path = directory.file(name);
  mcap::WriterOptions how;
  how.header.library = "another program";
  mcap::Writer writer(path, how);
  std::vector<std::uint16_t> channels;
  for (const auto& [topic, said] : topics) {
    mcap::Channel channel;
    if (!said.schema_encoding.empty()) {
      mcap::Schema schema;
      schema.name = "pkg/msg/Count";
      schema.encoding = said.schema_encoding;
      const auto bytes = std::as_bytes(std::span(said.schema));
      schema.data.assign(bytes.begin(), bytes.end());
      channel.schema = writer.add(schema);
    }
    channel.topic = topic;
    channel.message_encoding = said.encoding;
    channels.push_back(writer.add(channel));
  }
  std::uint64_t n = 0;
  for (const std::uint64_t time : times) {
    std::string payload("\0\1\0\0", 4);
    payload.append(reinterpret_cast<const char*>(&++n), sizeof(n));
    const mcap::View piece = std::as_bytes(std::span(payload));
    for (const std::uint16_t channel : channels) {
      writer.write({channel, 0, time, time}, std::span(&piece, 1));
    }
  }
  writer.close();
  return path;
}

}  // namespace lot::testing
