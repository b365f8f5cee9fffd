// SPDX-License-Identifier: Apache-2.0

// The plain program of CycloneDDS in hop.py, with the gateway's quality of service.
//
//     dds_arm send|receive TOPIC BOARD [--bytes N] [--frames N] [--period-us N] [--window N]

#include <dds/dds.h>

#include "frame.h"
#include "run.hpp"

namespace bench {
namespace {

dds_entity_t must(dds_entity_t result, const char* what) {
  if (result < 0) throw std::runtime_error(std::string(what) + ": " + dds_strretcode(-result));
  return result;
}

/// A participant and a topic.
struct Domain {
  explicit Domain(const Settings& settings)
      : participant(must(dds_create_participant(DDS_DOMAIN_DEFAULT, nullptr, nullptr), "join")),
        topic(must(dds_create_topic(participant, &bench_Frame__desc, settings.topic.c_str(),
                                    nullptr, nullptr),
                   "topic")),
        qos(dds_create_qos()) {
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_MSECS(100));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, static_cast<std::int32_t>(settings.depth));
  }
  Domain(const Domain&) = delete;
  Domain& operator=(const Domain&) = delete;
  ~Domain() {
    dds_delete_qos(qos);
    dds_delete(participant);
  }

  dds_entity_t participant;
  dds_entity_t topic;
  dds_qos_t* qos;
};

void send(const Settings& settings) {
  const Domain domain(settings);
  const dds_entity_t writer =
      must(dds_create_writer(domain.participant, domain.topic, domain.qos, nullptr), "writer");
  std::vector<std::uint8_t> data(settings.bytes);
  send_all(settings, [&](std::uint64_t number, std::uint64_t bytes) {
    bench_Frame_ frame{};
    frame.number = number;
    fill(data.data(), bytes, number);
    frame.data._buffer = data.data();
    frame.data._length = frame.data._maximum = static_cast<std::uint32_t>(bytes);
    frame.stamp_ns = now_ns();
    must(dds_write(writer, &frame), "write");
  });
}

/// It takes into one frame, whose memory is used again.
void receive(const Settings& settings) {
  const Domain domain(settings);
  const dds_entity_t reader =
      must(dds_create_reader(domain.participant, domain.topic, domain.qos, nullptr), "reader");
  const dds_entity_t wait = must(dds_create_waitset(domain.participant), "wait set");
  must(dds_set_status_mask(reader, DDS_DATA_AVAILABLE_STATUS), "mask");
  must(dds_waitset_attach(wait, reader, 0), "attach");
  bench_Frame_ frame{};
  Receipt receipt(settings);
  for (bool goes_on = true; goes_on;) {
    void* at = &frame;
    dds_sample_info_t info{};
    if (must(dds_take(reader, &at, &info, 1, 1), "take") == 0) {
      const int woken = must(dds_waitset_wait(wait, nullptr, 0, DDS_SECS(20)), "wait");
      if (woken == 0) throw std::runtime_error("no frame for 20 s");
    } else if (info.valid_data) {
      goes_on = receipt.take(frame.number, frame.stamp_ns, frame.data._buffer, frame.data._length);
    }
  }
  receipt.print();
  dds_sample_free(&frame, &bench_Frame__desc, DDS_FREE_CONTENTS);
}

void work(const Settings& settings) {
  if (settings.role == "send") return send(settings);
  receive(settings);
}

}  // namespace
}  // namespace bench

int main(int argc, char** argv) { return bench::main_of(argc, argv, "dds_arm", bench::work); }
