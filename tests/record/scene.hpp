// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstring>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "lot/lot.hpp"
#include "lot/recorder.hpp"

#include "mcap/reader.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/scratch.hpp"

/// What the tests of lot::Recorder share: messages, a segment with a directory, a file's content.
namespace lot::testing {

struct Note {
  std::uint64_t number = 0;
};
struct Picture {
  std::uint32_t number;
  ShmString label;
  ShmVector<std::uint8_t> pixels;
};

/// What a file has, in its order.
struct Content {
  struct One {
    std::string topic;
    std::uint32_t sequence;
    std::uint64_t log_time;
    std::uint64_t publish_time;
    std::string payload;
  };
  explicit Content(const std::string& path) : reader(path) {
    auto each = reader.messages();
    while (const auto message = each.next()) {
      messages.push_back({reader.channels().at(message->head.channel).topic, message->head.sequence,
                          message->head.log_time, message->head.publish_time,
                          text(message->payload)});
    }
  }
  std::vector<One> of(const std::string& topic) const {
    std::vector<One> found;
    for (const One& one : messages) {
      if (one.topic == topic) found.push_back(one);
    }
    return found;
  }
  /// What the file's end says of a topic.
  std::string said(const std::string& topic, const std::string& key) {
    for (const auto& index : reader.metadata()) {
      const mcap::Metadata about = reader.read(index);
      if (about.name == "lot.topic" && about.pairs.at("topic") == topic) return about.pairs.at(key);
    }
    return "";
  }
  mcap::Reader reader;
  std::vector<One> messages;
};

inline void put(ShmPusher<Note>& pusher, std::uint64_t number) {
  must_go(pusher.push(pusher.loan(Note{number})));
}
inline void put(ShmPusher<Picture>& pusher, std::uint32_t number, std::size_t bytes) {
  auto picture = pusher.loan();
  picture->number = number;
  picture->label = "picture " + std::to_string(number);
  picture->pixels.resize(bytes);
  std::iota(picture->pixels.begin(), picture->pixels.end(), static_cast<std::uint8_t>(number));
  must_go(pusher.push(std::move(picture)));
}
inline std::uint64_t number_in(const std::string& payload) {
  std::uint64_t number = 0;
  std::memcpy(&number, payload.data() + 4, sizeof(number));
  return number;
}

struct Scene {
  RecorderOptions what() const {
    RecorderOptions options;
    options.path = directory.file();
    options.topics = {"*"};
    return options;
  }
  Directory directory;
  EngineOptions where = fresh();
  ShmEngine engine{where};
};
inline const RecorderStatus::Topic* topic_of(const RecorderStatus& status,
                                             const std::string& name) {
  for (const auto& topic : status.topics) {
    if (topic.name == name) return &topic;
  }
  return nullptr;
}
inline std::uint64_t recorded(const Recorder& recorder, const std::string& name) {
  const RecorderStatus status = recorder.status();
  const auto* const topic = topic_of(status, name);
  return topic == nullptr ? 0 : topic->messages;
}

}  // namespace lot::testing
