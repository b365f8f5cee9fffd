// SPDX-License-Identifier: Apache-2.0
#include "gateway/outgoing.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <exception>
#include <limits>
#include <optional>
#include <utility>

#include "lot/error.hpp"

#include "gateway/names.hpp"
#include "gateway/peer.hpp"
#include "gateway/quality.hpp"
#include "gateway/ros_types.hpp"
#include "gateway/thread.hpp"
#include "transport/ring_ends.hpp"

namespace lot::gateway {
namespace {

using namespace std::chrono_literals;

/// What a peer may have of a topic out of this segment: CycloneDDS's limit is that of the network.
constexpr std::uint64_t kAnySize = std::numeric_limits<std::uint32_t>::max();

std::string dds_topic_for(const std::string& topic, const RouteSettings& settings) {
  if (!settings.dds_topic.empty()) return settings.dds_topic;
  const std::optional<std::string> name = dds_topic_of(record::name_in_file(topic));
  if (!name) {
    throw Error(EINVAL, topic, "ROS 2 allows no such name of a topic",
                "give it another one there: dds_topic");
  }
  return *name;
}

PullerOptions looking_on(OutgoingRoute::From from) {
  PullerOptions options;
  options.observer = true;
  options.history = from == OutgoingRoute::From::Now       ? 0
                    : from == OutgoingRoute::From::Latched ? 1
                                                           : ~std::uint64_t{0};
  return options;
}

/// An observer of the topic. Throws lot::Error: EAGAIN where it has no publisher but gateways,
/// which others of the domain need not see.
AnyPuller puller_of(ShmEngine& engine, const std::string& topic, OutgoingRoute::From from) {
  AnyPuller puller = engine.subscribe_any(topic, looking_on(from));
  (void)puller.size();  // joins the rings that there are
  const bool has_publisher = std::ranges::any_of(
      detail::PullerAccess::core(puller).sources(),
      [](const transport::Source& source) { return source.publisher != kProcessName; });
  if (!has_publisher) throw Error(EAGAIN, topic, "it has no publisher here", "");
  return puller;
}

/// When it was pushed, by the clock that DDS's times are of.
dds_time_t time_of(const Envelope& envelope) {
  const dds_time_t now = dds_time();
  if (!envelope.pushed) return now;
  const auto age = std::chrono::steady_clock::now() - *envelope.pushed;
  return now - std::clamp<dds_time_t>(std::chrono::nanoseconds(age).count(), 0, now);
}

}  // namespace

OutgoingRoute::OutgoingRoute(ShmEngine& engine, const Domain& domain, std::string topic,
                             const RouteSettings& settings, From from, const std::string& place,
                             Ledger* ledger)
    : topic_(std::move(topic)),
      settings_(settings),
      dds_topic_(dds_topic_for(topic_, settings_)),
      puller_(puller_of(engine, topic_, from)),
      stream_(topic_, puller_.type()),
      cdr_(domain.participant(), dds_topic_, dds_type_of(stream_.schema.name), kAnySize),
      entry_(ledger == nullptr ? nullptr : ledger->entry(Ledger::Way::Out, topic_)),
      progress_(entry_ == nullptr ? Progress() : entry_->told()),
      counts_before_(progress_.counts) {
  const Peer peer{place, stream_.type, entry_ == nullptr ? 0 : ledger->id(), progress_.written};
  const Qos qos = qos_of(settings_.quality, user_data_of(peer));
  writer_ = Entity(dds_create_writer(domain.participant(), cdr_.get(), qos.get(), nullptr),
                   dds_topic_, "make a writer");
  if (!is_as_in_ros(dds_type_of(stream_.schema.name), stream_.schema.msg)) {
    const std::string text = topic_ + ": its type is called " + stream_.schema.name +
                             " and has other fields than that message of ROS 2: a node reads "
                             "nonsense, or nothing. Give the type another name";
    tally_.went_wrong(text.c_str());
  }
  thread_ = begin_thread("lot-out", topic_, [this] { run(); });
}

void OutgoingRoute::end() noexcept {
  stopping_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void OutgoingRoute::run() noexcept {
  const StopToken stop = stopping_.get_token();
  while (!stop.stop_requested()) {
    if (!carry_next(stop)) return;
  }
  carry_the_rest();
}

bool OutgoingRoute::carry_next(const StopToken& stop) noexcept {
  try {
    AnyBorrow message = puller_.borrow(stop);
    if (message) carry(message);
    if (puller_.status() != Status::PublisherGone) return true;
    tally_.ended();
    return false;
  } catch (const std::exception& e) {
    if (note(e)) return false;
    dds_sleepfor(DDS_MSECS(10));  // the next look goes on behind what was wrong
    return true;
  }
}

void OutgoingRoute::carry_the_rest() noexcept {
  try {
    for (std::size_t left = puller_.size(); left != 0; --left) {
      AnyBorrow message = puller_.try_borrow();
      if (!message) return;
      carry(message);
    }
  } catch (const std::exception& e) {
    note(e);
  }
}

bool OutgoingRoute::note(const std::exception& error) noexcept try {
  tally_.went_wrong(error.what());
  const auto* const known = dynamic_cast<const Error*>(&error);
  if (known == nullptr || known->error_number() != ESTALE) return false;
  tally_.ended();
  return true;
} catch (const std::exception&) {
  return false;  // there is not even memory to say so
}

bool OutgoingRoute::may_carry(const Envelope& from) {
  tally_.add(&Counts::missed, from.missed);
  if (publishers_.insert(from.publisher_id).second) {
    const std::uint64_t known = from.missed + progress_.next_of(from.publisher_id);
    tally_.add(&Counts::before, from.sequence - std::min(from.sequence, known));
  }
  progress_.set_next(from.publisher_id, from.sequence + 1);
  if (from.publisher != kProcessName) return true;
  tally_.add(&Counts::looped);
  return false;
}

bool OutgoingRoute::is_unheard() const {
  if (entry_ != nullptr || settings_.quality.durability == Durability::TransientLocal) return false;
  dds_publication_matched_status_t matched{};
  require(dds_get_publication_matched_status(writer_.get(), &matched), dds_topic_,
          "look for readers");
  return matched.current_count == 0;
}

void OutgoingRoute::write_down() noexcept {
  if (entry_ == nullptr) return;
  progress_.counts = tally_.numbers(counts_before_);
  entry_->write(progress_);
}

void OutgoingRoute::carry(AnyBorrow& message) {
  const Envelope from = message.envelope();
  if (!may_carry(from)) return write_down();
  if (is_unheard()) return tally_.add(&Counts::unheard);
  CdrSample sample;
  try {
    sample = cdr_.sample(stream_.program, message.root());
  } catch (const Error& e) {
    if (e.error_number() == ESTALE) throw;
    tally_.add(&Counts::damaged);
    tally_.went_wrong(e.what());
    return write_down();
  }
  message.end();
  const std::uint64_t bytes = sample.bytes().size();
  sample.stamp(time_of(from));
  // Written down first. Killed before DDS has the sample: its number is missing there, and so the
  // gateways that it does not reach count it.
  ++progress_.written;
  tally_.carried(bytes);
  write_down();
  const dds_return_t result = dds_forwardcdr(writer_.get(), sample.release());
  if (result == DDS_RETCODE_OK) return;
  --progress_.written;
  tally_.was_lost(bytes);
  write_down();
  require(result == DDS_RETCODE_TIMEOUT ? DDS_RETCODE_OK : result, dds_topic_, "write");
}

}  // namespace lot::gateway
