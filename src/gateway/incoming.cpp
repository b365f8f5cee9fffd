// SPDX-License-Identifier: Apache-2.0
#include "gateway/incoming.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <exception>
#include <new>
#include <string_view>
#include <utility>
#include <vector>

#include "lot/error.hpp"

#include "codec/decode.hpp"
#include "gateway/names.hpp"
#include "gateway/peer.hpp"
#include "gateway/quality.hpp"
#include "gateway/ros_types.hpp"
#include "gateway/thread.hpp"

namespace lot::gateway {
namespace {

/// So many samples are taken at once.
constexpr std::size_t kAtOnce = 16;
/// So many writers may come while the route asks for them.
constexpr std::size_t kMoreAtOnce = 16;
/// What the wait says of the guard condition.
constexpr dds_attach_t kStop = 1;

/// The user data of a writer that the reader has met. Empty: it has gone, or has none.
std::string user_data_of_writer(dds_entity_t reader, dds_instance_handle_t writer) {
  dds_builtintopic_endpoint_t* const endpoint = dds_get_matched_publication_data(reader, writer);
  if (endpoint == nullptr) return "";
  std::string text = user_data_in(endpoint->qos);
  dds_builtintopic_free_endpoint(endpoint);
  return text;
}

}  // namespace

IncomingRoute::IncomingRoute(ShmEngine& engine, const Domain& domain, IncomingTopic what,
                             const RouteSettings& settings, Ledger::Entry* entry)
    : engine_(engine),
      what_(std::move(what)),
      settings_(settings),
      stream_(what_.topic, what_.type),
      dds_type_(dds_type_of(stream_.schema.name)),
      cdr_(domain.participant(), what_.dds_topic, dds_type_, what_.max_size),
      entry_(entry),
      progress_(entry == nullptr ? Progress() : entry->told()),
      counts_before_(progress_.counts),
      stopping_(dds_create_guardcondition(domain.participant()), what_.dds_topic,
                "make a condition"),
      rate_(settings_.limits.max_rate) {
  const Qos qos = qos_of(settings_.quality, "");
  reader_ = Entity(dds_create_reader(domain.participant(), cdr_.get(), qos.get(), nullptr),
                   what_.dds_topic, "make a reader");
  constexpr std::uint32_t kNews = DDS_DATA_AVAILABLE_STATUS | DDS_SUBSCRIPTION_MATCHED_STATUS |
                                  DDS_REQUESTED_DEADLINE_MISSED_STATUS;
  require(dds_set_status_mask(reader_.get(), kNews), what_.dds_topic, "choose what wakes");
  waiting_ = Entity(dds_create_waitset(domain.participant()), what_.dds_topic, "make a wait set");
  require(dds_waitset_attach(waiting_.get(), reader_.get(), 0), what_.dds_topic, "wait for it");
  require(dds_waitset_attach(waiting_.get(), stopping_.get(), kStop), what_.dds_topic,
          "wait for the end");
  thread_ = begin_thread("lot-in", what_.topic, [this] { run(); });
}

void IncomingRoute::end() noexcept {
  dds_set_guardcondition(stopping_.get(), true);
  if (thread_.joinable()) thread_.join();
}

Counts IncomingRoute::told() const {
  Counts counts = tally_.told();
  counts.refused += cdr_.too_large();
  return counts;
}

void IncomingRoute::run() noexcept {
  for (;;) {
    std::array<dds_attach_t, 2> woken{};
    const dds_return_t count =
        dds_waitset_wait(waiting_.get(), woken.data(), woken.size(), DDS_INFINITY);
    for (std::size_t i = 0; i < woken.size() && std::cmp_less(i, count); ++i) {
      if (woken[i] == kStop) return take_the_rest();
    }
    try {
      look_at_writers();
      while (take_some()) {
      }
    } catch (const std::exception& e) {
      note(e);
      dds_sleepfor(DDS_MSECS(10));  // what is left is taken in the next round
    }
  }
}

void IncomingRoute::take_the_rest() noexcept {
  try {
    for (std::uint32_t left = settings_.quality.depth; left != 0; --left) {
      if (!take_some()) return;
    }
  } catch (const std::exception& e) {
    note(e);
  }
}

void IncomingRoute::note(const std::exception& error) noexcept try {
  tally_.went_wrong(error.what());
  const auto* const known = dynamic_cast<const Error*>(&error);
  const bool is_another =
      known != nullptr && (known->error_number() == ESTALE || known->error_number() == EPROTOTYPE);
  if (is_another) tally_.ended();
} catch (const std::exception&) {
  // There is not even memory to say so.
}

void IncomingRoute::look_at_writers() {
  dds_requested_deadline_missed_status_t late{};
  require(dds_get_requested_deadline_missed_status(reader_.get(), &late), what_.dds_topic,
          "look for what is late");
  if (late.total_count_change != 0) {
    const std::string text = what_.topic + ": no message came within its deadline";
    tally_.went_wrong(text.c_str());
  }
  dds_subscription_matched_status_t matched{};
  require(dds_get_subscription_matched_status(reader_.get(), &matched), what_.dds_topic,
          "look for writers");
  if (matched.total_count_change == 0 && matched.current_count_change == 0) return;
  while (take_some()) {
  }
  forget_writers(static_cast<std::size_t>(matched.current_count));
  if (matched.current_count == 0) publishing_.reset();
}

void IncomingRoute::forget_writers(std::size_t about) {
  std::vector<dds_instance_handle_t> here(about + kMoreAtOnce);
  const dds_return_t count =
      require(dds_get_matched_publications(reader_.get(), here.data(), here.size()),
              what_.dds_topic, "look for writers");
  if (std::cmp_greater(count, here.size())) return;  // as many have just come: the next time
  here.resize(static_cast<std::size_t>(count));
  std::erase_if(writers_, [&](const auto& entry) {
    return std::ranges::find(here, entry.first) == here.end();
  });
}

bool IncomingRoute::take_some() {
  std::array<ddsi_serdata*, kAtOnce> taken{};
  std::array<dds_sample_info_t, kAtOnce> infos{};
  const dds_return_t count =
      require(dds_takecdr(reader_.get(), taken.data(), kAtOnce, infos.data(), DDS_ANY_STATE),
              what_.dds_topic, "take samples");
  std::array<CdrSample, kAtOnce> samples;
  for (std::size_t i = 0; i < kAtOnce; ++i) samples[i] = CdrSample(taken[i]);
  for (std::size_t i = 0; std::cmp_less(i, count); ++i) {
    if (!infos[i].valid_data) continue;
    carry(samples[i], infos[i].publication_handle);
    write_down();
  }
  return count != 0;
}

IncomingRoute::Known& IncomingRoute::known(dds_instance_handle_t writer) {
  const auto found = writers_.find(writer);
  if (found != writers_.end()) return found->second;
  return writers_.emplace(writer, judge(writer)).first->second;
}

void IncomingRoute::count_lost(Known& writer, std::uint64_t number) {
  const std::uint64_t too_large = cdr_.too_large();
  const std::uint64_t refused = too_large - std::exchange(too_large_, too_large);
  const std::uint64_t running = writer.before + number;
  const std::uint64_t next = writer.line == 0 ? writer.next : progress_.next_of(writer.line);
  const std::uint64_t gap = next == 0 || running < next ? 0 : running - next;
  tally_.add(&Counts::lost, gap - std::min(gap, refused));
  const std::uint64_t then = std::max(next, running + 1);
  writer.next = then;
  if (writer.line != 0) progress_.set_next(writer.line, then);
}

void IncomingRoute::write_down() noexcept {
  if (entry_ == nullptr) return;
  progress_.counts = tally_.numbers(counts_before_);
  entry_->write(progress_);
}

IncomingRoute::Known IncomingRoute::judge(dds_instance_handle_t writer) const try {
  const std::optional<Peer> peer = peer_of(user_data_of_writer(reader_.get(), writer));
  if (!peer) return {Writer::IsCarried, 0, 0, 0};
  // A message of ROS 2 is what its name says, as it is of a writer that says nothing more.
  const bool is_another = peer->type && !peer->type.is_same(what_.type) && !is_ros_type(dds_type_);
  const Writer what = peer->segment == what_.place ? Writer::IsOfThisSegment
                      : is_another                 ? Writer::IsOfAnotherType
                                                   : Writer::IsCarried;
  return {what, peer->ledger, peer->written, 0};
} catch (const Error&) {
  return {Writer::IsOfAnotherType, 0, 0, 0};  // it says a type that can be none
}

void IncomingRoute::carry(const CdrSample& sample, dds_instance_handle_t writer) {
  Known& its = known(writer);
  count_lost(its, sample.number());
  if (its.what == Writer::IsOfThisSegment) return tally_.add(&Counts::looped);
  if (its.what == Writer::IsOfAnotherType) return tally_.add(&Counts::refused);
  if (!rate_.allows(RateLimit::Clock::now())) return tally_.add(&Counts::refused);
  try {
    begin_to_publish();
    AnyLoan loan = publishing_->pusher.loan();
    decode(publishing_->program, sample.bytes(), loan.root());
    (void)publishing_->pusher.push(std::move(loan));  // under Overwrite it is always Status::Ok
    tally_.carried(sample.bytes().size());
  } catch (const OutOfMemory& e) {
    tally_.add(&Counts::lost);
    const std::string text = what_.topic + ": a message was lost (max_memory_mib says how much " +
                             "of the segment the topic may use): " + e.what();
    tally_.went_wrong(text.c_str());
  } catch (const Error& e) {
    const bool is_its_bytes =
        e.error_number() == EBADMSG || e.error_number() == ENOTSUP || e.error_number() == ERANGE;
    tally_.add(is_its_bytes ? &Counts::damaged : &Counts::refused);
    note(e);
  }
}

void IncomingRoute::begin_to_publish() {
  if (publishing_) return;
  PusherOptions options;
  options.depth = settings_.quality.depth;
  options.max_bytes =
      settings_.limits.max_bytes != 0 ? settings_.limits.max_bytes : what_.most_bytes;
  AnyPusher pusher = engine_.advertise_any(what_.topic, what_.type, options);
  codec::Program program(pusher.type().description());
  publishing_.emplace(Publishing{std::move(pusher), std::move(program)});
}

}  // namespace lot::gateway
