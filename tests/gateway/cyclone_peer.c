/* SPDX-License-Identifier: Apache-2.0 */

/* A plain program of CycloneDDS, with types that idlc has made.
 *
 *     cyclone_peer send TOPIC SIZE PERIOD_MS      writes frames until it is killed
 *     cyclone_peer receive TOPIC COUNT            ends when so many frames have come, and are right
 */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <dds/dds.h>

#include "frame.h"
#include "pattern.h"

typedef robot_msg_dds__Frame_ Frame;

static dds_entity_t must(dds_entity_t result, const char* what) {
  if (result >= 0) return result;
  fprintf(stderr, "%s: %s\n", what, dds_strretcode(-result));
  exit(1);
}

static int send_frames(dds_entity_t writer, size_t size, unsigned period) {
  uint8_t* const data = malloc(size + 1);
  for (uint32_t number = 1;; ++number) {
    char label[32];
    Frame frame;
    memset(&frame, 0, sizeof frame);
    snprintf(label, sizeof label, "frame %u", number);
    fill_pattern(data, size, number);
    frame.number = number;
    frame.label = label;
    frame.data._buffer = data;
    frame.data._length = frame.data._maximum = (uint32_t)size;
    const dds_return_t result = dds_write(writer, &frame);
    if (result != DDS_RETCODE_TIMEOUT) must(result, "write");
    dds_sleepfor(DDS_MSECS(period));
  }
}

static int is_right(const Frame* frame) {
  char label[32];
  snprintf(label, sizeof label, "frame %u", frame->number);
  const size_t wrong = first_wrong(frame->data._buffer, frame->data._length, frame->number);
  if (strcmp(label, frame->label) == 0 && wrong == frame->data._length) return 1;
  printf("frame %u: wrong at byte %zu, label %s\n", frame->number, wrong, frame->label);
  return 0;
}

static int receive_frames(dds_entity_t reader, unsigned count) {
  for (unsigned seen = 0; seen < count;) {
    void* taken = NULL;
    dds_sample_info_t info;
    const dds_return_t n = must(dds_take(reader, &taken, &info, 1, 1), "take");
    if (n == 0) {
      dds_sleepfor(DDS_MSECS(1));
      continue;
    }
    if (info.valid_data && !is_right(taken)) return 1;
    seen += info.valid_data;
    must(dds_return_loan(reader, &taken, n), "return");
  }
  printf("%u frames\n", count);
  return 0;
}

int main(int argc, char** argv) {
  setvbuf(stdout, NULL, _IOLBF, 0);
  if (argc < 4) return 2;
  const dds_entity_t participant =
      must(dds_create_participant(DDS_DOMAIN_DEFAULT, NULL, NULL), "participant");
  const dds_entity_t topic = must(
      dds_create_topic(participant, &robot_msg_dds__Frame__desc, argv[2], NULL, NULL), "topic");
  dds_qos_t* const qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_MSECS(100));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 8);
  const unsigned long number = strtoul(argv[3], NULL, 10);
  if (strcmp(argv[1], "send") == 0) {
    const dds_entity_t writer = must(dds_create_writer(participant, topic, qos, NULL), "writer");
    printf("ready\n");
    return send_frames(writer, number, argc > 4 ? (unsigned)strtoul(argv[4], NULL, 10) : 10);
  }
  const dds_entity_t reader = must(dds_create_reader(participant, topic, qos, NULL), "reader");
  printf("ready\n");
  const int result = receive_frames(reader, (unsigned)number);
  dds_delete_qos(qos);
  dds_delete(participant);
  return result;
}
