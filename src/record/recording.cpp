// SPDX-License-Identifier: Apache-2.0
#include "lot/recording.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <deque>
#include <list>
#include <map>
#include <set>
#include <string_view>
#include <utility>

#include "lot/error.hpp"

#include "codec/decode.hpp"
#include "codec/encode.hpp"
#include "codec/program.hpp"
#include "mcap/reader.hpp"
#include "record/pattern.hpp"
#include "record/private_memory.hpp"
#include "record/types.hpp"

namespace lot {
namespace {

RecordedTime time_of(std::uint64_t nanoseconds) {
  constexpr auto kMost = static_cast<std::uint64_t>(RecordedTime::max().time_since_epoch().count());
  return RecordedTime(
      std::chrono::nanoseconds(static_cast<std::int64_t>(std::min(nanoseconds, kMost))));
}
std::uint64_t nanoseconds_of(RecordedTime time) {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(time.time_since_epoch().count(), 0));
}

/// How much more memory than bytes a message takes: a vector of nothing takes 4 bytes and 32.
constexpr std::size_t kFactors[] = {3, 12, 128};
constexpr std::size_t kBeside = 8192;

std::uint64_t number_in(const mcap::Pairs& pairs, const char* key) {
  const auto found = pairs.find(key);
  std::uint64_t number = 0;
  if (found == pairs.end()) return 0;
  const std::string& text = found->second;
  (void)std::from_chars(text.data(), text.data() + text.size(), number);
  return number;
}

/// The type of a channel's messages. Throws lot::Error: why there is none.
AnyType type_for(const mcap::Channel& channel, const mcap::Schema* schema) {
  const auto refuse = [&](const std::string& why) { throw Error(EINVAL, channel.topic, why, ""); };
  if (channel.message_encoding != "cdr") {
    refuse("its messages are " + channel.message_encoding + ", not cdr");
  }
  if (schema == nullptr) refuse("it has no schema");
  if (schema->encoding != "ros2msg") refuse("its schema is " + schema->encoding + ", not ros2msg");
  const std::string text(reinterpret_cast<const char*>(schema->data.data()), schema->data.size());
  if (AnyType type = record::type_of(channel.metadata)) {
    // A file may say anything: the schema is what others read it by.
    if (record::is_like(type, text)) return type;
  }
  return record::type_of_schema(schema->name, text);
}

}  // namespace

struct Recording::Impl {
  /// A topic's type, and how its messages are decoded.
  struct Carried {
    AnyType type;
    std::optional<codec::Program> program;
  };
  struct File {
    explicit File(const std::string& its_path) : path(its_path), reader(its_path) {}
    std::string path;
    mcap::Reader reader;
    std::map<std::uint16_t, std::size_t> topics;  ///< of channels
    bool is_cut = false;
  };

  void open(const std::string& path) {
    File& file = files.emplace_back(path);
    for (const auto& [id, channel] : file.reader.channels()) {
      file.topics[id] = topic_of(file, channel);
    }
    for (const auto& [id, count] : file.reader.statistics().channel_messages) {
      const auto found = file.topics.find(id);
      if (found != file.topics.end()) topics[found->second].messages += count;
    }
    const mcap::Statistics& all = file.reader.statistics();
    if (all.messages != 0) {
      begin = has_messages ? std::min(begin, all.start) : all.start;
      end = std::max(end, all.end);
      has_messages = true;
    }
    const bool is_told = read_counts(file);
    if (!is_told || !file.reader.has_summary()) look_through(file, !is_told);
  }

  std::size_t topic_of(File& file, const mcap::Channel& channel) {
    const auto& schemas = file.reader.schemas();
    const auto schema = schemas.find(channel.schema);
    RecordedTopic topic;
    topic.name = channel.topic;
    topic.encoding = channel.message_encoding;
    if (schema != schemas.end()) {
      topic.type = schema->second.name;
      topic.schema_encoding = schema->second.encoding;
      topic.schema.assign(reinterpret_cast<const char*>(schema->second.data.data()),
                          schema->second.data.size());
    }
    const auto is_it = [&](const RecordedTopic& other) {
      return other.name == topic.name && other.type == topic.type &&
             other.encoding == topic.encoding && other.schema == topic.schema;
    };
    const auto found = std::ranges::find_if(topics, is_it);
    if (found != topics.end()) return static_cast<std::size_t>(found - topics.begin());
    Carried& its = carried.emplace_back();
    try {
      its.type = type_for(channel, schema == schemas.end() ? nullptr : &schema->second);
      its.program.emplace(its.type.description());
    } catch (const Error& e) {
      topic.objection = e.what();
    }
    topics.push_back(std::move(topic));
    return topics.size() - 1;
  }

  /// What the file's end says. False: it says nothing.
  bool read_counts(File& file) {
    bool is_there = false;
    for (const auto& index : file.reader.metadata()) {
      if (index.name != "lot.topic") continue;
      const mcap::Metadata about = file.reader.read(index);
      is_there = true;
      const auto channel = static_cast<std::uint16_t>(number_in(about.pairs, "channel"));
      const auto found = file.topics.find(channel);
      if (found == file.topics.end()) continue;
      RecordedTopic& topic = topics[found->second];
      topic.missed += number_in(about.pairs, "missed");
      topic.lost += number_in(about.pairs, "lost") + number_in(about.pairs, "damaged");
      topic.left_out += number_in(about.pairs, "left_out");
    }
    return is_there;
  }
  /// Finds out whether the file was closed and, if that is asked, by the numbers of its messages
  /// what was missed.
  void look_through(File& file, bool counts_gaps) {
    const bool is_ours = file.reader.header().library.starts_with("lot ");
    if (file.reader.has_summary() && !is_ours) return;
    struct Span {
      std::uint32_t first = 0;
      std::uint32_t last = 0;
      std::uint64_t messages = 0;
    };
    std::map<std::size_t, Span> spans;
    mcap::Stream stream(file.path);
    while (const auto message = stream.next()) {
      const auto found = file.topics.find(message->head.channel);
      if (found == file.topics.end()) continue;
      Span& span = spans[found->second];
      if (span.messages++ == 0) span.first = message->head.sequence;
      span.last = message->head.sequence;
    }
    file.is_cut = !stream.is_whole();
    if (!counts_gaps || !is_ours) return;
    // A gap of a damaged file may be what the damage has taken.
    const bool is_damaged = stream.damage().chunks + stream.damage().records != 0;
    const auto count = is_damaged ? &RecordedTopic::lost : &RecordedTopic::missed;
    for (const auto& [topic, span] : spans) {
      const std::uint64_t there = std::uint64_t{span.last - span.first} + 1;
      topics[topic].*count += there - std::min(there, span.messages);
    }
  }

  std::list<File> files;
  std::vector<RecordedTopic> topics;
  std::deque<Carried> carried;  ///< of each topic
  bool has_messages = false;
  std::uint64_t begin = 0;
  std::uint64_t end = 0;
};

// ---- messages
// ------------------------------------------------------------------------------------

struct RecordedMessage::Reading {
  /// The messages of one file.
  struct Source {
    Recording::Impl::File* file;
    mcap::Messages messages;
    std::optional<mcap::Message> next;
  };
  /// How messages of a topic become those of another type.
  struct Fitted {
    std::size_t topic;
    AnyType type;
    codec::Program program;
  };

  Reading(std::shared_ptr<Recording::Impl> its, const RecordingQuery& query)
      : impl(std::move(its)) {
    for (auto& file : impl->files) {
      mcap::Query asked;
      asked.from = nanoseconds_of(query.from);
      if (query.until != RecordedTime::max()) asked.until = nanoseconds_of(query.until);
      asked.channels.emplace();
      for (const auto& [channel, topic] : file.topics) {
        if (query.topics.empty() || record::matches_any(query.topics, impl->topics[topic].name))
          asked.channels->insert(channel);
      }
      if (asked.channels->empty() || query.until < RecordedTime()) continue;
      Source& source = sources.emplace_back(Source{&file, file.reader.messages(asked), {}});
      source.next = source.messages.next();
    }
  }

  std::optional<RecordedMessage> next() {
    if (returned != nullptr) {
      Source* const its = std::exchange(returned, nullptr);
      its->next = its->messages.next();
    }
    decoded.reset();
    for (Source& source : sources) {
      const bool is_first =
          source.next &&
          (returned == nullptr || source.next->head.log_time < returned->next->head.log_time);
      if (is_first) returned = &source;
    }
    if (returned == nullptr) return std::nullopt;
    const mcap::Message& from = *returned->next;
    RecordedMessage message;
    message.number_ = returned->file->topics.at(from.head.channel);  // one that was asked for
    message.topic_ = &impl->topics[message.number_];
    message.log_time_ = time_of(from.head.log_time);
    message.publish_time_ = time_of(from.head.publish_time);
    message.sequence_ = from.head.sequence;
    message.payload_ = Bytes(from.payload.data(), from.payload.size());
    message.reading_ = this;
    return message;
  }

  Recording::Impl::Carried& carried(const RecordedMessage& message) const {
    const RecordedTopic& topic = impl->topics[message.number_];
    if (!topic.objection.empty()) throw Error(EINVAL, topic.name, topic.objection, "");
    return impl->carried[message.number_];
  }

  Value root(const RecordedMessage& message) {
    if (decoded) return *decoded;
    Recording::Impl::Carried& its = carried(message);
    const Description& description = its.type.description();
    for (const std::size_t factor : kFactors) {
      try {
        const std::size_t bytes =
            description.root().size + kBeside + factor * message.payload_.size();
        const MutableValue value = memory.make(description, bytes);
        codec::decode(*its.program, message.payload_, value);
        decoded.emplace(value);
        return *decoded;
      } catch (const OutOfMemory&) {
        if (factor == std::end(kFactors)[-1]) throw;
      }
    }
    return *decoded;  // the last factor returns or throws
  }

  /// The program of a type, whose messages are to be those of the topic.
  const codec::Program& fitted(const RecordedMessage& message, const AnyType& type) {
    for (const Fitted& fit : fits) {
      if (fit.topic == message.number_ && fit.type.known() == type.known()) return fit.program;
    }
    const Recording::Impl::Carried& its = carried(message);
    const bool is_same =
        its.type.is_same(type) || record::is_like(type, impl->topics[message.number_].schema);
    if (!is_same) {
      throw Error(
          EINVAL, impl->topics[message.number_].name,
          "it was recorded as " + its.type.name() + ", and " + type.name() + " has other fields",
          "");
    }
    return fits.emplace_back(Fitted{message.number_, type, codec::Program(type.description())})
        .program;
  }

  std::shared_ptr<Recording::Impl> impl;
  std::deque<Source> sources;
  Source* returned = nullptr;
  record::PrivateMemory memory;
  std::optional<Value> decoded;  ///< the message that was returned
  std::list<Fitted> fits;
  codec::Encoded encoded;
};

const AnyType& RecordedMessage::type() const { return reading_->carried(*this).type; }
Value RecordedMessage::root() const { return reading_->root(*this); }

void RecordedMessage::copy_to(const AnyLoan& loan) const {
  codec::decode(reading_->fitted(*this, loan.type()), payload_, loan.root());
}

bool RecordedMessage::is_equal(const AnyMessage& message) const {
  if (!message) return false;
  codec::encode(codec::Program(message.type().description()), message.root(), reading_->encoded);
  std::size_t at = 0;
  for (const Bytes& piece : reading_->encoded.pieces()) {
    if (piece.size() > payload_.size() - at) return false;
    if (std::memcmp(payload_.data() + at, piece.data(), piece.size()) != 0) return false;
    at += piece.size();
  }
  constexpr std::size_t kMostPadding = 3;  // by which others fill a word
  return payload_.size() - at <= kMostPadding;
}

RecordedMessages::RecordedMessages(std::unique_ptr<RecordedMessage::Reading> reading) noexcept
    : reading_(std::move(reading)) {}
RecordedMessages::~RecordedMessages() = default;
RecordedMessages::RecordedMessages(RecordedMessages&&) noexcept = default;
RecordedMessages& RecordedMessages::operator=(RecordedMessages&&) noexcept = default;

std::optional<RecordedMessage> RecordedMessages::next() { return reading_->next(); }

// ---- the recording
// -------------------------------------------------------------------------------

Recording::Recording(const std::string& path) : Recording(std::vector<std::string>{path}) {}

Recording::Recording(const std::vector<std::string>& paths) : impl_(std::make_shared<Impl>()) {
  if (paths.empty()) throw Error(EINVAL, "Recording", "there are no files", "name one");
  for (const std::string& path : paths) impl_->open(path);
}

Recording::~Recording() = default;
Recording::Recording(Recording&&) noexcept = default;
Recording& Recording::operator=(Recording&&) noexcept = default;

const std::vector<RecordedTopic>& Recording::topics() const noexcept { return impl_->topics; }
RecordedTime Recording::begin() const noexcept { return time_of(impl_->begin); }
RecordedTime Recording::end() const noexcept { return time_of(impl_->end); }

RecordedMessages Recording::messages(const RecordingQuery& query) {
  return RecordedMessages(std::make_unique<RecordedMessage::Reading>(impl_, query));
}

AnyType Recording::type_of(const RecordedTopic& topic) const {
  const auto first = impl_->topics.data();
  if (&topic < first || &topic >= first + impl_->topics.size()) {
    throw Error(EINVAL, topic.name, "it is no topic of this recording", "take one of topics()");
  }
  if (!topic.objection.empty()) throw Error(EINVAL, topic.name, topic.objection, "");
  return impl_->carried[static_cast<std::size_t>(&topic - first)].type;
}

RecordingDamage Recording::damage() const {
  RecordingDamage all;
  for (const auto& file : impl_->files) {
    const mcap::Damage& its = file.reader.damage();
    all.chunks += its.chunks;
    all.records += its.records;
    all.bytes += its.bytes;
    if (all.first.empty()) all.first = its.first;
    all.is_cut = all.is_cut || file.is_cut;
  }
  return all;
}

}  // namespace lot
