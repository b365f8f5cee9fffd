/* SPDX-License-Identifier: Apache-2.0
 *
 * The C interface: a camera and a viewer in two processes. The camera makes the type of its frames
 * while it runs; a C++ program reads them as
 *
 *     struct Frame { std::uint32_t number, width, height; lot::ShmString encoding;
 * lot::ShmVector<std::uint8_t> data; };
 *
 * The viewer does without the type: it asks for fields by their names. No pixel is copied.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <inttypes.h>

#include <lot/lot.h>

enum { kFrames = 3, kWidth = 1024, kHeight = 1024 };

/* Prints what went wrong, where something did. */
static bool good(int status, const char* what) {
  if (status >= LOT_OK) return true;
  fprintf(stderr, "%s: %s\n", what, lot_error_text());
  return false;
}

/* What has been made is released in any case: NULL is, too. */
static bool make_frame_type(lot_type** frame) {
  lot_type* number = NULL;
  lot_type* byte = NULL;
  lot_type* text = NULL;
  lot_type* bytes = NULL;
  bool made = good(lot_type_number(LOT_KIND_UINT, 4, &number), "number") &&
              good(lot_type_number(LOT_KIND_UINT, 1, &byte), "byte") &&
              good(lot_type_string(&text), "string") &&
              good(lot_type_vector(byte, &bytes), "vector");
  if (made) {
    const lot_field fields[] = {{"number", number},
                                {"width", number},
                                {"height", number},
                                {"encoding", text},
                                {"data", bytes}};
    made = good(lot_type_struct("Frame", fields, sizeof fields / sizeof *fields, frame), "Frame");
  }
  lot_type_release(number);
  lot_type_release(byte);
  lot_type_release(text);
  lot_type_release(bytes);
  return made;
}

static bool send(lot_publisher* out, uint32_t number) {
  lot_loan* frame = NULL;
  void* pixels = NULL;
  size_t size = 0;
  const bool sent = good(lot_publisher_loan(out, &frame), "loan") &&
                    good(lot_set_uint64(frame, "number", number), "number") &&
                    good(lot_set_uint64(frame, "width", kWidth), "width") &&
                    good(lot_set_uint64(frame, "height", kHeight), "height") &&
                    good(lot_set_text(frame, "encoding", "mono8", 5), "encoding") &&
                    good(lot_resize(frame, "data", (size_t)kWidth * kHeight), "data") &&
                    good(lot_loan_bytes(frame, "data", &pixels, &size), "data");
  if (sent) {
    ((unsigned char*)pixels)[size - 1] = (unsigned char)number; /* where the viewer reads it */
    if (good(lot_publisher_push(out, &frame, NULL), "push")) return true;
  }
  lot_loan_release(frame);
  return false;
}

static bool camera(lot_stop* stop) {
  lot_engine* engine = NULL;
  lot_type* type = NULL;
  lot_publisher* out = NULL;
  bool all = good(lot_engine_open(NULL, &engine), "engine") && make_frame_type(&type) &&
             good(lot_advertise(engine, "/camera/front", type, NULL, &out), "/camera/front") &&
             lot_publisher_wait_for_readers(out, 1, LOT_FOREVER, stop) == LOT_OK;
  for (uint32_t n = 1; all && n <= kFrames; ++n) all = send(out, n);
  lot_publisher_close(out);
  lot_type_release(type);
  lot_engine_close(engine);
  return all;
}

/* Subscribes when the camera is there. */
static bool subscribe(lot_engine* engine, lot_stop* stop, lot_subscriber** in) {
  int status;
  do {
    status = lot_subscribe(engine, "/camera/front", NULL, NULL, in);
    if (status == -ENOENT) usleep(1000);
  } while (status == -ENOENT && !lot_stop_requested(stop));
  return good(status, "/camera/front");
}

static bool show(const lot_message* frame, uint32_t expected) {
  uint64_t number = 0;
  lot_view encoding = {NULL, 0};
  lot_view pixels = {NULL, 0};
  char text[80];
  size_t needed = 0;
  if (!good(lot_get_uint64(frame, "number", &number), "number") ||
      !good(lot_get_text(frame, "encoding", &encoding), "encoding") ||
      !good(lot_get_bytes(frame, "data", &pixels), "data") ||
      !good(lot_print(frame, "", text, sizeof text, &needed), "frame")) {
    return false;
  }
  const unsigned last = ((const unsigned char*)pixels.data)[pixels.size - 1];
  printf("%" PRIu64 ": %zu pixels of %.*s, the last one %u: %s\n", number, pixels.size,
         (int)encoding.size, (const char*)encoding.data, last, text);
  return number == expected && last == expected;
}

static bool viewer(lot_stop* stop) {
  lot_engine* engine = NULL;
  lot_subscriber* in = NULL;
  bool all = good(lot_engine_open(NULL, &engine), "engine") && subscribe(engine, stop, &in);
  for (uint32_t n = 1; all && n <= kFrames; ++n) {
    lot_message* frame = NULL;
    all = lot_borrow(in, LOT_FOREVER, stop, &frame) == LOT_OK && show(frame, n);
    lot_message_release(frame);
  }
  lot_subscriber_close(in);
  lot_engine_close(engine);
  return all;
}

/* Runs one of the two. It ends well, too, where Ctrl-C has ended it. */
static int run(bool (*body)(lot_stop* stop), lot_stop* stop) {
  const int code = body(stop) || lot_stop_requested(stop) ? 0 : 1;
  lot_stop_release(stop);
  return code;
}

int main(void) {
  char segment[32];
  snprintf(segment, sizeof segment, "lot_camera_%d", (int)getpid());
  setenv("LOT_SEGMENT", segment, 0); /* unless the caller names one */

  lot_stop* stop = NULL; /* before the child begins: no signal ends it in another way */
  if (!good(lot_stop_on_signals(&stop), "signals")) return 1;
  const pid_t parent = getpid();
  const pid_t child = fork(); /* before any engine: a child's handles are inert */
  if (child == -1) return 1;
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    return getppid() == parent ? run(camera, stop) : 1;
  }
  const int code = run(viewer, stop);
  if (code != 0) kill(child, SIGTERM);
  int status = -1;
  while (waitpid(child, &status, 0) == -1) continue;
  return code != 0 || status != 0;
}
