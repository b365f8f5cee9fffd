// SPDX-License-Identifier: Apache-2.0

// A program of Fast DDS, with types that fastddsgen has made.
//
//     fastdds_peer send TOPIC SIZE PERIOD_MS      writes frames until it is killed
//     fastdds_peer receive TOPIC COUNT            ends when so many frames have come, and are right

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include "framePubSubTypes.h"
#include "pattern.h"

namespace {

namespace fast = eprosima::fastdds::dds;
using Frame = robot::msg::dds_::Frame_;

constexpr std::uint32_t kSocketBytes = 4 << 20;  // the system may give less
constexpr auto kAnySize = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;

fast::DomainParticipant* new_participant() {
  fast::DomainParticipantQos qos;
  qos.transport().use_builtin_transports = false;  // no shared memory: the network
  const auto network = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  network->receiveBufferSize = kSocketBytes;
  network->sendBufferSize = kSocketBytes;
  qos.transport().user_transports.push_back(network);
  return fast::DomainParticipantFactory::get_instance()->create_participant(0, qos);
}

template <class Qos>
Qos with_quality(Qos qos) {
  qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
  qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
  qos.history().depth = 8;
  qos.endpoint().history_memory_policy = kAnySize;
  return qos;
}

int send_frames(fast::DomainParticipant& participant, fast::Topic* topic, std::size_t size,
                unsigned period) {
  auto qos = with_quality(fast::DATAWRITER_QOS_DEFAULT);
  qos.publish_mode().kind =
      fast::ASYNCHRONOUS_PUBLISH_MODE;  // what is larger than a packet needs it
  auto* const writer =
      participant.create_publisher(fast::PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
  if (writer == nullptr) return 1;
  std::printf("ready\n");
  Frame frame;
  for (std::uint32_t number = 1;; ++number) {
    frame.number(number);
    frame.label("frame " + std::to_string(number));
    frame.data().resize(size);
    fill_pattern(frame.data().data(), size, number);
    writer->write(&frame);
    std::this_thread::sleep_for(std::chrono::milliseconds(period));
  }
}

bool is_right(const Frame& frame) {
  const std::size_t wrong = first_wrong(frame.data().data(), frame.data().size(), frame.number());
  if (frame.label() == "frame " + std::to_string(frame.number()) && wrong == frame.data().size())
    return true;
  std::printf("frame %u: wrong at byte %zu, label %s\n", frame.number(), wrong,
              frame.label().c_str());
  return false;
}

int receive_frames(fast::DomainParticipant& participant, fast::Topic* topic, unsigned count) {
  auto* const reader = participant.create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT)
                           ->create_datareader(topic, with_quality(fast::DATAREADER_QOS_DEFAULT));
  if (reader == nullptr) return 1;
  std::printf("ready\n");
  for (unsigned seen = 0; seen < count;) {
    Frame frame;
    fast::SampleInfo info;
    if (!reader->wait_for_unread_message({1, 0})) continue;
    if (reader->take_next_sample(&frame, &info) != ReturnCode_t::RETCODE_OK || !info.valid_data)
      continue;
    if (!is_right(frame)) return 1;
    ++seen;
  }
  std::printf("%u frames\n", count);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  if (argc < 4) return 2;
  fast::DomainParticipant* const participant = new_participant();
  if (participant == nullptr) return 1;
  const fast::TypeSupport type(new robot::msg::dds_::Frame_PubSubType());
  type.register_type(participant);
  fast::Topic* const topic =
      participant->create_topic(argv[2], type.get_type_name(), fast::TOPIC_QOS_DEFAULT);
  const unsigned long number = std::strtoul(argv[3], nullptr, 10);
  if (std::strcmp(argv[1], "send") == 0) {
    return send_frames(*participant, topic, number,
                       argc > 4 ? static_cast<unsigned>(std::strtoul(argv[4], nullptr, 10)) : 10);
  }
  return receive_frames(*participant, topic, static_cast<unsigned>(number));
}
