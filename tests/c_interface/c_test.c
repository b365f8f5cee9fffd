/* SPDX-License-Identifier: Apache-2.0
 *
 * The interface in C, from a program in C11: types, publishers, subscribers, views, errors, ends in
 * any order, fork, and processes that are killed. Each case is a function; main() runs all, or
 * those named.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <lot/lot.h>

static const char* running = "";

/* Ends the test where something is not so. */
#define CHECK(what)                                                                           \
  do {                                                                                        \
    if (!(what)) {                                                                            \
      fprintf(stderr, "%s:%d: %s: %s (last error: %s)\n", __FILE__, __LINE__, running, #what, \
              lot_error_text());                                                              \
      exit(1);                                                                                \
    }                                                                                         \
  } while (0)

/* A message of numbers alone: in C the same struct. */
struct point {
  uint8_t flag;
  double x;
  int16_t counts[3];
  float y;
};

static lot_engine* open_engine(void) {
  lot_engine* engine = NULL;
  CHECK(lot_engine_open(NULL, &engine) == LOT_OK);
  return engine;
}

static lot_type* number(lot_kind kind, size_t size) {
  lot_type* type = NULL;
  CHECK(lot_type_number(kind, size, &type) == LOT_OK);
  return type;
}

static lot_type* point_type(const char* name) {
  lot_type* const byte = number(LOT_KIND_UINT, 1);
  lot_type* const real = number(LOT_KIND_FLOAT, 8);
  lot_type* const half = number(LOT_KIND_INT, 2);
  lot_type* const single = number(LOT_KIND_FLOAT, 4);
  lot_type* counts = NULL;
  lot_type* point = NULL;
  CHECK(lot_type_array(half, 3, &counts) == LOT_OK);
  const lot_field fields[] = {{"flag", byte}, {"x", real}, {"counts", counts}, {"y", single}};
  CHECK(lot_type_struct(name, fields, 4, &point) == LOT_OK);
  lot_type_release(byte);
  lot_type_release(real);
  lot_type_release(half);
  lot_type_release(single);
  lot_type_release(counts);
  return point;
}

/* {label: string, scores: vector of float32, points: vector of point} */
static lot_type* box_type(void) {
  lot_type* const single = number(LOT_KIND_FLOAT, 4);
  lot_type* const point = point_type("point");
  lot_type* text = NULL;
  lot_type* scores = NULL;
  lot_type* points = NULL;
  lot_type* box = NULL;
  CHECK(lot_type_string(&text) == LOT_OK);
  CHECK(lot_type_vector(single, &scores) == LOT_OK);
  CHECK(lot_type_vector(point, &points) == LOT_OK);
  const lot_field fields[] = {{"label", text}, {"scores", scores}, {"points", points}};
  CHECK(lot_type_struct("box", fields, 3, &box) == LOT_OK);
  lot_type_release(single);
  lot_type_release(point);
  lot_type_release(text);
  lot_type_release(scores);
  lot_type_release(points);
  return box;
}

/* An end of each kind on one topic. */
struct ends {
  lot_engine* engine;
  lot_type* type;
  lot_publisher* out;
  lot_subscriber* in;
};

static struct ends ends_of(lot_type* type, const lot_publisher_options* options) {
  struct ends ends = {open_engine(), type, NULL, NULL};
  CHECK(lot_advertise(ends.engine, "/topic", type, options, &ends.out) == LOT_OK);
  CHECK(lot_subscribe(ends.engine, "/topic", type, NULL, &ends.in) == LOT_OK);
  return ends;
}

static void close_ends(struct ends* ends) {
  lot_subscriber_close(ends->in);
  lot_publisher_close(ends->out);
  lot_type_release(ends->type);
  lot_engine_close(ends->engine);
}

static void push_point(lot_publisher* out, double x) {
  lot_loan* loan = NULL;
  CHECK(lot_publisher_loan(out, &loan) == LOT_OK);
  struct point* const point = lot_loan_data(loan);
  point->x = x;
  CHECK(lot_publisher_push(out, &loan, NULL) == LOT_OK);
  CHECK(loan == NULL);
}

static double x_of(const lot_message* message) {
  return ((const struct point*)lot_message_data(message))->x;
}

/* ---- types ---- */

static void a_struct_lies_as_the_compiler_lays_it_out(void) {
  lot_type* const type = point_type("point");
  CHECK(strcmp(lot_type_name(type), "point") == 0);
  CHECK(lot_type_size(type) == sizeof(struct point));
  CHECK(lot_type_alignment(type) == _Alignof(struct point));
  const size_t offsets[] = {offsetof(struct point, flag), offsetof(struct point, x),
                            offsetof(struct point, counts), offsetof(struct point, y)};
  const lot_kind kinds[] = {LOT_KIND_UINT, LOT_KIND_FLOAT, LOT_KIND_ARRAY, LOT_KIND_FLOAT};
  size_t count = 0;
  CHECK(lot_type_count(type, &count) == LOT_OK && count == 4);
  for (size_t i = 0; i < count; ++i) {
    const char* name = NULL;
    size_t offset = 0;
    lot_type* part = NULL;
    lot_kind kind = LOT_KIND_OPAQUE;
    CHECK(lot_type_field(type, i, &name, &offset, &part) == LOT_OK);
    CHECK(offset == offsets[i] && name != NULL);
    CHECK(lot_type_kind(part, &kind) == LOT_OK && kind == kinds[i]);
    if (kind == LOT_KIND_ARRAY) {
      lot_type* element = NULL;
      CHECK(lot_type_count(part, &count) == LOT_OK && count == 3);
      count = 4;
      CHECK(lot_type_element(part, &element) == LOT_OK && lot_type_size(element) == 2);
      CHECK(lot_type_element(element, &element) == -EINVAL);
      lot_type_release(element);
    }
    lot_type_release(part);
  }
  CHECK(lot_type_field(type, 4, NULL, NULL, NULL) == -EINVAL);
  CHECK(lot_type_field(type, 0, NULL, NULL, NULL) == LOT_OK); /* what is NULL is not told */
  lot_type_release(type);
}

static void a_type_goes_through_bytes(void) {
  lot_type* const box = box_type();
  lot_type* copy = NULL;
  lot_type* other = NULL;
  lot_view bytes = {NULL, 0};
  bool is_same = false;
  uint64_t hashes[4] = {0, 0, 0, 0};
  CHECK(lot_type_encode(box, &bytes) == LOT_OK && bytes.size > 0);
  CHECK(lot_type_decode("box", lot_type_alignment(box), bytes, 0, &copy) == LOT_OK);
  CHECK(lot_type_is_same(box, copy, &is_same) == LOT_OK && is_same);
  CHECK(lot_type_hashes(box, &hashes[0], &hashes[1]) == LOT_OK);
  CHECK(lot_type_hashes(copy, &hashes[2], &hashes[3]) == LOT_OK);
  CHECK(hashes[0] == hashes[2] && hashes[1] == hashes[3] && hashes[0] != 0 && hashes[1] != 0);
  CHECK(lot_type_decode("crate", lot_type_alignment(box), bytes, 0, &other) == LOT_OK);
  CHECK(lot_type_is_same(box, other, &is_same) == LOT_OK && !is_same);
  lot_type_release(other);

  other = copy; /* what fails writes nothing */
  const lot_view cut = {bytes.data, bytes.size - 1};
  CHECK(lot_type_decode("box", 8, cut, 0, &other) == -EINVAL && other == copy);
  CHECK(lot_type_decode("box", 3, bytes, 0, &other) == -EINVAL && other == copy);
  CHECK(lot_type_decode("box", 4096, bytes, 0, &other) == -EINVAL && other == copy);
  CHECK(strstr(lot_error_text(), "alignment") != NULL && strcmp(lot_error_object(), "box") == 0);
  lot_type_release(copy);
  lot_type_release(box);
}

static void what_can_be_no_type_is_refused(void) {
  lot_type* const byte = number(LOT_KIND_UINT, 1);
  lot_type* none = NULL;
  lot_type* large = NULL;
  CHECK(lot_type_number(LOT_KIND_STRUCT, 4, &none) == -EINVAL);
  CHECK(lot_type_number(LOT_KIND_UINT, 3, &none) == -EINVAL);
  CHECK(lot_type_array(byte, 0, &none) == -EINVAL);
  CHECK(lot_type_array(byte, (size_t)1 << 60, &none) == -EINVAL);
  CHECK(lot_type_vector(NULL, &none) == -EINVAL);
  CHECK(strstr(lot_error_text(), "element") != NULL);
  CHECK(lot_type_struct("", NULL, 0, &none) == -EINVAL);
  CHECK(lot_type_struct("s", NULL, 1, &none) == -EINVAL);
  CHECK(lot_type_struct(NULL, NULL, 0, &none) == -EINVAL);
  CHECK(lot_type_opaque("o", 12, 8, &none) == -EINVAL);
  CHECK(lot_type_opaque("o", 12, 3, &none) == -EINVAL);
  CHECK(lot_type_opaque("o", 0, 1, &none) == -EINVAL);
  CHECK(lot_type_duration(byte, 1, 0, &none) == -EINVAL);
  CHECK(lot_type_enum("e", NULL, &none) == -EINVAL);
  CHECK(lot_type_array(byte, (size_t)1 << 47, &large) == LOT_OK);
  const lot_field fields[] = {{"a", large}, {"b", large}, {"c", large}};
  CHECK(lot_type_struct("s", fields, 3, &none) == -EINVAL);
  CHECK(none == NULL);
  const lot_field nameless = {NULL, byte};
  const char* name = NULL;
  CHECK(lot_type_struct("s", &nameless, 1, &none) == LOT_OK);
  CHECK(lot_type_field(none, 0, &name, NULL, NULL) == LOT_OK && strcmp(name, "") == 0);
  lot_type_release(none);
  lot_type_release(large);
  lot_type_release(byte);
}

/* ---- messages ---- */

static void fill_box(lot_loan* loan) {
  const float scores[] = {0.5F, 1.5F, 2.5F};
  const lot_view bytes = {scores, sizeof scores};
  const char* const text = "a label that is longer than a string has in itself";
  CHECK(lot_set_text(loan, "label", text, strlen(text)) == LOT_OK);
  CHECK(lot_set_bytes(loan, "scores", bytes) == LOT_OK);
  CHECK(lot_resize(loan, "points", 2) == LOT_OK);
  CHECK(lot_set_int64(loan, "points[1].counts[2]", -3) == LOT_OK);
  CHECK(lot_set_uint64(loan, "points[1].flag", 200) == LOT_OK);
  CHECK(lot_set_double(loan, "points[1].x", 1e300) == LOT_OK);
}

static void check_box(const lot_message* box) {
  lot_view view = {NULL, 0};
  size_t count = 0;
  int64_t whole = 0;
  uint64_t flag = 0;
  double real = 0;
  lot_kind kind = LOT_KIND_OPAQUE;
  CHECK(lot_get_text(box, "label", &view) == LOT_OK);
  CHECK(view.size == 50 && memcmp(view.data, "a label that", 12) == 0);
  CHECK(lot_get_bytes(box, "scores", &view) == LOT_OK);
  CHECK(view.size == 3 * sizeof(float) && ((const float*)view.data)[2] == 2.5F);
  CHECK(lot_get_count(box, "points", &count) == LOT_OK && count == 2);
  CHECK(lot_get_count(box, "", &count) == LOT_OK && count == 3);
  CHECK(lot_get_int64(box, "points[1].counts[2]", &whole) == LOT_OK && whole == -3);
  CHECK(lot_get_uint64(box, "points[1].flag", &flag) == LOT_OK && flag == 200);
  CHECK(lot_get_double(box, "points[1].x", &real) == LOT_OK && real == 1e300);
  CHECK(lot_get_kind(box, "points", &kind) == LOT_OK && kind == LOT_KIND_VECTOR);
  CHECK(lot_get_bytes(box, "points", &view) == LOT_OK);
  CHECK(view.size == 2 * sizeof(struct point));
  CHECK(((const struct point*)view.data)[1].x == 1e300);
}

static void check_refusals(const lot_message* box) {
  lot_view view = {NULL, 0};
  uint64_t whole = 77;
  CHECK(lot_get_uint64(box, "points[1].counts[2]", &whole) == -ERANGE && whole == 77);
  CHECK(lot_get_uint64(box, "points[2].flag", &whole) == -EINVAL);
  CHECK(lot_get_uint64(box, "points[99999999999999999999].flag", &whole) == -EINVAL);
  CHECK(lot_get_uint64(box, "....", &whole) == -EINVAL);
  CHECK(lot_get_uint64(box, "label", &whole) == -EINVAL);
  CHECK(lot_get_uint64(box, NULL, &whole) == -EINVAL);
  CHECK(lot_get_uint64(NULL, "label", &whole) == -EINVAL);
  CHECK(lot_get_uint64(box, "label", NULL) == -EINVAL);
  CHECK(lot_get_bytes(box, "", &view) == -EINVAL && view.data == NULL);
  CHECK(lot_get_text(box, "sores", &view) == -EINVAL);
  CHECK(strstr(lot_error_text(), "scores") != NULL); /* which fields there are */
}

static void fields_are_set_and_read_by_their_paths(void) {
  struct ends ends = ends_of(box_type(), NULL);
  lot_loan* loan = NULL;
  lot_message* box = NULL;
  char text[40];
  size_t needed = 0;
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  fill_box(loan);
  check_box(lot_loan_message(loan));
  CHECK(lot_set_uint64(loan, "points[1].flag", 256) == -ERANGE);
  CHECK(lot_set_uint64(loan, "label", 1) == -EINVAL);
  CHECK(lot_resize(loan, "label", 1) == -EINVAL);
  CHECK(lot_message_keep(lot_loan_message(loan), &box) == -EINVAL && box == NULL);
  CHECK(lot_publisher_forward(ends.out, lot_loan_message(loan), NULL) == -EINVAL);
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK && loan == NULL);
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == -EINVAL);

  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &box) == LOT_OK);
  check_box(box);
  check_refusals(box);
  CHECK(lot_print(box, "points[1].counts", text, sizeof text, &needed) == LOT_OK);
  CHECK(strcmp(text, "[0, 0, -3]") == 0 && needed == 10);
  CHECK(lot_print(box, "points[1].counts", text, 4, &needed) == LOT_OK);
  CHECK(strcmp(text, "[0,") == 0 && needed == 10);
  CHECK(lot_print(box, "", NULL, 0, &needed) == LOT_OK && needed > 40);
  lot_message_release(box);
  close_ends(&ends);
}

static void a_topic_tells_its_type_to_a_program_without_it(void) {
  struct ends ends = ends_of(box_type(), NULL);
  lot_subscriber* in = NULL;
  lot_publisher* out = NULL;
  lot_type* type = NULL;
  lot_message* box = NULL;
  bool is_same = false;
  CHECK(lot_subscribe(ends.engine, "/none", NULL, NULL, &in) == -ENOENT && in == NULL);
  CHECK(lot_type_of_topic(ends.engine, "/none", &type) == -ENOENT && type == NULL);
  CHECK(lot_subscribe(ends.engine, "/topic", NULL, NULL, &in) == LOT_OK);
  CHECK(lot_type_is_same(lot_subscriber_type(in), ends.type, &is_same) == LOT_OK && is_same);
  CHECK(lot_type_of_topic(ends.engine, "/topic", &type) == LOT_OK);
  CHECK(lot_type_is_same(type, ends.type, &is_same) == LOT_OK && is_same);
  lot_type_release(type);

  /* a message goes on to another topic, without a copy */
  CHECK(lot_advertise(ends.engine, "/again", lot_subscriber_type(in), NULL, &out) == LOT_OK);
  lot_subscriber* again = NULL;
  CHECK(lot_subscribe(ends.engine, "/again", NULL, NULL, &again) == LOT_OK);
  lot_loan* loan = NULL;
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  fill_box(loan);
  const void* const place = lot_loan_data(loan);
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK);
  CHECK(lot_borrow(in, LOT_NOW, NULL, &box) == LOT_OK);
  CHECK(lot_message_data(box) == place);
  CHECK(lot_publisher_forward(out, box, NULL) == LOT_OK);
  lot_message_release(box);
  CHECK(lot_pull(again, LOT_NOW, NULL, &box) == LOT_OK && lot_message_data(box) == place);
  check_box(box);
  lot_message_release(box);

  lot_type* const point = point_type("point");
  lot_publisher* wrong = NULL;
  CHECK(lot_advertise(ends.engine, "/topic", point, NULL, &wrong) == -EPROTOTYPE && wrong == NULL);
  CHECK(strcmp(lot_error_object(), "/topic") == 0);
  lot_type_release(point);
  lot_subscriber_close(in);
  lot_subscriber_close(again);
  lot_publisher_close(out);
  close_ends(&ends);
}

static void an_opaque_message_begins_as_zeros(void) {
  lot_type* type = NULL;
  CHECK(lot_type_opaque("secret", 4096, 64, &type) == LOT_OK);
  struct ends ends = ends_of(type, NULL);
  for (int round = 0; round < 3; ++round) {
    lot_loan* loan = NULL;
    lot_message* message = NULL;
    CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
    unsigned char* const bytes = lot_loan_data(loan);
    CHECK((uintptr_t)bytes % 64 == 0 && bytes[0] == 0 && bytes[4095] == 0);
    memset(bytes, 7, 4096);
    CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK);
    CHECK(lot_pull(ends.in, LOT_NOW, NULL, &message) == LOT_OK);
    CHECK(((const unsigned char*)lot_message_data(message))[4095] == 7);
    lot_message_release(message);
  }
  close_ends(&ends);
}

static void a_loan_that_is_released_is_not_published(void) {
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_loan* loan = NULL;
  lot_message* message = NULL;
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  lot_loan_release(loan);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &message) == LOT_EMPTY && message == NULL);
  lot_loan_release(NULL);
  lot_message_release(NULL);
  lot_subscriber_close(NULL);
  lot_publisher_close(NULL);
  lot_type_release(NULL);
  lot_engine_close(NULL);
  lot_stop_release(NULL);
  close_ends(&ends);
}

/* ---- borrows, ends in any order ---- */

static void one_borrow_at_a_time(void) {
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_message* first = NULL;
  lot_message* second = NULL;
  lot_message* kept = NULL;
  push_point(ends.out, 1);
  push_point(ends.out, 2);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &first) == LOT_OK);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &second) == -EBUSY && second == NULL);
  CHECK(lot_pull(ends.in, LOT_NOW, NULL, &second) == -EBUSY && second == NULL);
  CHECK(x_of(first) == 1);
  CHECK(lot_message_keep(first, &kept) == LOT_OK);
  lot_message_release(first);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &second) == LOT_OK && x_of(second) == 2);
  CHECK(x_of(kept) == 1);
  lot_message_release(second);
  lot_message_release(kept);
  close_ends(&ends);
}

static void handles_end_in_any_order(void) {
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_message* kept = NULL;
  lot_message* copy = NULL;
  lot_message* borrowed = NULL;
  lot_loan* loan = NULL;
  push_point(ends.out, 1);
  push_point(ends.out, 2);
  CHECK(lot_pull(ends.in, LOT_NOW, NULL, &kept) == LOT_OK);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &borrowed) == LOT_OK);
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  close_ends(&ends);
  CHECK(x_of(kept) == 1 && x_of(borrowed) == 2);
  CHECK(lot_message_keep(kept, &copy) == LOT_OK);
  CHECK(lot_message_data(copy) == lot_message_data(kept));
  lot_message_release(kept);
  lot_message_release(borrowed);
  CHECK(x_of(copy) == 1 && strcmp(lot_type_name(lot_message_type(copy)), "point") == 0);
  lot_message_release(copy);
  lot_loan_release(loan);
}

static void a_kept_message_does_not_hold_a_closed_subscriber(void) {
  lot_publisher_options options = lot_publisher_defaults();
  options.policy = LOT_REFUSE;
  options.depth = 2;
  struct ends ends = ends_of(point_type("point"), &options);
  lot_message* kept = NULL;
  size_t readers = 1;
  push_point(ends.out, 1);
  CHECK(lot_pull(ends.in, LOT_NOW, NULL, &kept) == LOT_OK);
  lot_subscriber_close(ends.in);
  ends.in = NULL;
  CHECK(lot_publisher_readers(ends.out, &readers) == LOT_OK && readers == 0);
  for (int i = 0; i < 10; ++i) push_point(ends.out, i);
  CHECK(x_of(kept) == 1);
  lot_message_release(kept);
  close_ends(&ends);
}

/* ---- waits ---- */

static void a_full_queue_leaves_the_loan_with_its_owner(void) {
  lot_publisher_options options = lot_publisher_defaults();
  options.policy = LOT_REFUSE;
  options.depth = 2;
  struct ends ends = ends_of(point_type("point"), &options);
  lot_loan* loan = NULL;
  lot_message* message = NULL;
  lot_stop* stop = NULL;
  push_point(ends.out, 1);
  push_point(ends.out, 2);
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_FULL && loan != NULL);
  CHECK(lot_publisher_push_for(ends.out, &loan, LOT_NOW, NULL) == LOT_FULL && loan != NULL);
  CHECK(lot_stop_new(&stop) == LOT_OK && !lot_stop_requested(stop));
  lot_stop_request(stop);
  CHECK(lot_stop_requested(stop));
  CHECK(lot_publisher_push(ends.out, &loan, stop) == LOT_STOPPED && loan != NULL);
  CHECK(lot_borrow(ends.in, LOT_NOW, stop, &message) == LOT_STOPPED && message == NULL);
  CHECK(lot_borrow(ends.in, LOT_FOREVER, stop, &message) == LOT_STOPPED && message == NULL);
  CHECK(lot_pull(ends.in, LOT_SECOND, stop, &message) == LOT_STOPPED && message == NULL);
  CHECK(lot_publisher_wait_for_readers(ends.out, 2, LOT_FOREVER, stop) == LOT_STOPPED);
  CHECK(lot_publisher_wait_for_readers(ends.out, 2, LOT_NOW, NULL) == LOT_TIMEOUT);
  CHECK(lot_publisher_wait_for_readers(ends.out, 1, LOT_FOREVER, NULL) == LOT_OK);
  for (int i = 0; i < 2; ++i) {
    CHECK(lot_borrow(ends.in, LOT_FOREVER, NULL, &message) == LOT_OK);
    lot_message_release(message);
  }
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK && loan == NULL);
  lot_stop_release(stop);
  close_ends(&ends);
}

static void* stop_soon(void* stop) {
  usleep(20000);
  lot_stop_request(stop);
  return NULL;
}

static void a_wait_ends_in_time_by_its_stop_and_with_the_publisher(void) {
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_message* message = NULL;
  lot_stop* stop = NULL;
  pthread_t thread;
  CHECK(lot_borrow(ends.in, 1000000, NULL, &message) == LOT_TIMEOUT && message == NULL);
  CHECK(lot_pull(ends.in, -5, NULL, &message) == LOT_EMPTY);
  CHECK(lot_stop_new(&stop) == LOT_OK);
  CHECK(pthread_create(&thread, NULL, stop_soon, stop) == 0);
  CHECK(lot_borrow(ends.in, LOT_FOREVER, stop, &message) == LOT_STOPPED);
  CHECK(pthread_join(thread, NULL) == 0);
  lot_publisher_close(ends.out);
  ends.out = NULL;
  CHECK(lot_borrow(ends.in, LOT_FOREVER, NULL, &message) == LOT_PUBLISHER_GONE && message == NULL);
  CHECK(strcmp(lot_status_text(LOT_PUBLISHER_GONE), "publisher gone") == 0);
  CHECK(strcmp(lot_status_text(-EINVAL), "Invalid argument") == 0);
  CHECK(strcmp(lot_status_text(4711), "unknown") == 0 &&
        strcmp(lot_status_text(-4711), "unknown") == 0);
  lot_stop_release(stop);
  close_ends(&ends);
}

static void an_envelope_says_where_a_message_comes_from(void) {
  lot_publisher_options options = lot_publisher_defaults();
  options.stamp = true;
  options.depth = 2;
  lot_engine_options naming = {.name = "a program in C"};
  lot_engine* engine = NULL;
  CHECK(lot_engine_open(&naming, &engine) == LOT_OK);
  CHECK(strstr(lot_engine_path(engine), getenv("LOT_SEGMENT")) != NULL);
  struct ends ends = ends_of(point_type("point"), &options);
  lot_envelope envelope;
  lot_message* message = NULL;
  size_t count = 0;
  int fd = -1;
  CHECK(lot_subscriber_envelope(ends.in, &envelope) == LOT_OK && envelope.publisher_id == 0);
  for (int i = 0; i < 5; ++i) push_point(ends.out, i);
  CHECK(lot_subscriber_size(ends.in, &count) == LOT_OK && count == 2);
  CHECK(lot_subscriber_publishers(ends.in, &count) == LOT_OK && count == 1);
  CHECK(lot_subscriber_fd(ends.in, &fd) == LOT_OK && fd >= 0);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &message) == LOT_OK && x_of(message) == 3);
  CHECK(lot_subscriber_envelope(ends.in, &envelope) == LOT_OK);
  CHECK(envelope.sequence == 3 && envelope.missed == 3 && envelope.publisher_id != 0);
  CHECK(strcmp(envelope.publisher, "a program in C") == 0 && envelope.pushed > 0);
  CHECK(lot_subscriber_missed(ends.in) == 3);
  lot_message_release(message);
  CHECK(lot_publisher_reserve(ends.out, 2, 1024) == LOT_OK);
  CHECK(lot_publisher_reserve(ends.out, 1000, (size_t)1 << 40) == -ENOBUFS);
  lot_engine_close(engine);
  close_ends(&ends);
}

/* ---- errors ---- */

static void* another_threads_error(void* unused) {
  (void)unused;
  lot_type* type = NULL;
  CHECK(strcmp(lot_error_text(), "") == 0);
  CHECK(lot_type_number(LOT_KIND_UINT, 5, &type) == -EINVAL);
  CHECK(strstr(lot_error_text(), "5 bytes") != NULL);
  return NULL;
}

static void each_thread_has_its_own_last_error(void) {
  lot_type* type = NULL;
  pthread_t thread;
  CHECK(lot_type_number(LOT_KIND_UINT, 7, &type) == -EINVAL);
  CHECK(pthread_create(&thread, NULL, another_threads_error, NULL) == 0);
  CHECK(pthread_join(thread, NULL) == 0);
  CHECK(strstr(lot_error_text(), "7 bytes") != NULL);
}

/* The call refuses an argument, and names it. */
#define REFUSES(argument, call) \
  CHECK((call) == -EINVAL && strcmp(lot_error_object(), (argument)) == 0)

static void a_missing_argument_of_a_type_is_named(void) {
  lot_type* const byte = number(LOT_KIND_UINT, 1);
  lot_type* none = NULL;
  lot_kind kind = LOT_KIND_OPAQUE;
  lot_view bytes = {NULL, 0};
  uint64_t hash = 0;
  size_t count = 0;
  bool is_same = false;
  const lot_field nameless = {"a", NULL};
  REFUSES("type", lot_type_number(LOT_KIND_UINT, 1, NULL));
  REFUSES("type", lot_type_string(NULL));
  REFUSES("element", lot_type_vector(NULL, &none));
  REFUSES("type", lot_type_vector(byte, NULL));
  REFUSES("element", lot_type_array(NULL, 3, &none));
  REFUSES("target", lot_type_reference(NULL, &none));
  REFUSES("name", lot_type_enum(NULL, byte, &none));
  REFUSES("number", lot_type_enum("e", NULL, &none));
  REFUSES("number", lot_type_duration(NULL, 1, 1, &none));
  REFUSES("clock", lot_type_time_point(NULL, byte, &none));
  REFUSES("duration", lot_type_time_point("steady_clock", NULL, &none));
  REFUSES("fields", lot_type_struct("s", NULL, 1, &none));
  REFUSES("fields", lot_type_struct("s", &nameless, 1, &none));
  REFUSES("name", lot_type_struct(NULL, NULL, 0, &none));
  REFUSES("name", lot_type_opaque(NULL, 8, 8, &none));
  REFUSES("bytes", lot_type_decode("s", 8, bytes, 0, &none));
  CHECK(lot_type_encode(byte, &bytes) == LOT_OK);
  REFUSES("name", lot_type_decode(NULL, 8, bytes, 0, &none));
  REFUSES("engine", lot_type_of_topic(NULL, "/topic", &none));
  REFUSES("type", lot_type_copy(NULL, &none));
  REFUSES("type", lot_type_copy(byte, NULL));
  REFUSES("a", lot_type_is_same(NULL, byte, &is_same));
  REFUSES("b", lot_type_is_same(byte, NULL, &is_same));
  REFUSES("is_same", lot_type_is_same(byte, byte, NULL));
  REFUSES("type", lot_type_kind(NULL, &kind));
  REFUSES("kind", lot_type_kind(byte, NULL));
  REFUSES("type", lot_type_hashes(NULL, &hash, &hash));
  REFUSES("layout", lot_type_hashes(byte, NULL, &hash));
  REFUSES("names", lot_type_hashes(byte, &hash, NULL));
  REFUSES("type", lot_type_count(NULL, &count));
  REFUSES("count", lot_type_count(byte, NULL));
  REFUSES("whole", lot_type_field(NULL, 0, NULL, NULL, NULL));
  REFUSES("type", lot_type_element(NULL, &none));
  REFUSES("type", lot_type_element(byte, NULL));
  REFUSES("type", lot_type_encode(NULL, &bytes));
  REFUSES("bytes", lot_type_encode(byte, NULL));
  CHECK(none == NULL && kind == LOT_KIND_OPAQUE && hash == 0 && count == 0);
  lot_type_release(byte);
}

static void a_missing_argument_of_a_publisher_is_named(void) {
  struct ends ends = ends_of(box_type(), NULL);
  lot_loan* loan = NULL;
  lot_loan* no_loan = NULL;
  lot_publisher* out = NULL;
  size_t count = 77;
  void* data = NULL;
  const lot_view nothing = {NULL, 1};
  REFUSES("engine", lot_advertise(NULL, "/topic", ends.type, NULL, &out));
  REFUSES("topic", lot_advertise(ends.engine, NULL, ends.type, NULL, &out));
  REFUSES("type", lot_advertise(ends.engine, "/topic", NULL, NULL, &out));
  REFUSES("publisher", lot_advertise(ends.engine, "/topic", ends.type, NULL, NULL));
  REFUSES("publisher", lot_publisher_loan(NULL, &loan));
  REFUSES("loan", lot_publisher_loan(ends.out, NULL));
  REFUSES("loan", lot_publisher_push(ends.out, NULL, NULL));
  REFUSES("*loan", lot_publisher_push(ends.out, &no_loan, NULL));
  REFUSES("publisher", lot_publisher_forward(NULL, NULL, NULL));
  REFUSES("message", lot_publisher_forward(ends.out, NULL, NULL));
  REFUSES("publisher", lot_publisher_readers(NULL, &count));
  REFUSES("count", lot_publisher_readers(ends.out, NULL));
  REFUSES("publisher", lot_publisher_wait_for_readers(NULL, 1, LOT_NOW, NULL));
  REFUSES("publisher", lot_publisher_reserve(NULL, 1, 1));
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  REFUSES("publisher", lot_publisher_push(NULL, &loan, NULL));
  REFUSES("loan", lot_set_int64(NULL, "label", 1));
  REFUSES("path", lot_set_int64(loan, NULL, 1));
  REFUSES("loan", lot_set_uint64(NULL, "label", 1));
  REFUSES("loan", lot_set_double(NULL, "label", 1));
  REFUSES("text", lot_set_text(loan, "label", NULL, 1));
  REFUSES("loan", lot_resize(NULL, "scores", 1));
  REFUSES("bytes", lot_set_bytes(loan, "scores", nothing));
  REFUSES("data", lot_loan_bytes(loan, "scores", NULL, &count));
  REFUSES("size", lot_loan_bytes(loan, "scores", &data, NULL));
  CHECK(out == NULL && data == NULL && count == 77 && loan != NULL);
  CHECK(lot_set_text(loan, "label", NULL, 0) == LOT_OK); /* nothing lies anywhere */
  CHECK(lot_set_bytes(loan, "scores", (lot_view){NULL, 0}) == LOT_OK);
  lot_loan_release(loan);
  close_ends(&ends);
}

static void a_missing_argument_of_a_subscriber_is_named(void) {
  struct ends ends = ends_of(box_type(), NULL);
  lot_engine* engine = NULL;
  lot_subscriber* in = NULL;
  lot_message* none = NULL;
  lot_loan* loan = NULL;
  lot_envelope envelope;
  lot_kind kind = LOT_KIND_OPAQUE;
  lot_view view = {NULL, 0};
  size_t count = 77;
  int64_t whole = 0;
  uint64_t natural = 0;
  double real = 0;
  int fd = -1;
  char text[1];
  REFUSES("engine", lot_engine_open(NULL, NULL));
  REFUSES("stop", lot_stop_new(NULL));
  REFUSES("stop", lot_stop_on_signals(NULL));
  REFUSES("engine", lot_subscribe(NULL, "/topic", NULL, NULL, &in));
  REFUSES("topic", lot_subscribe(ends.engine, NULL, NULL, NULL, &in));
  REFUSES("subscriber", lot_subscribe(ends.engine, "/topic", NULL, NULL, NULL));
  REFUSES("topic", lot_type_of_topic(ends.engine, NULL, &ends.type));
  REFUSES("subscriber", lot_borrow(NULL, LOT_NOW, NULL, &none));
  REFUSES("message", lot_borrow(ends.in, LOT_NOW, NULL, NULL));
  REFUSES("subscriber", lot_pull(NULL, LOT_NOW, NULL, &none));
  REFUSES("subscriber", lot_subscriber_envelope(NULL, &envelope));
  REFUSES("envelope", lot_subscriber_envelope(ends.in, NULL));
  REFUSES("subscriber", lot_subscriber_publishers(NULL, &count));
  REFUSES("count", lot_subscriber_publishers(ends.in, NULL));
  REFUSES("subscriber", lot_subscriber_size(NULL, &count));
  REFUSES("count", lot_subscriber_size(ends.in, NULL));
  REFUSES("subscriber", lot_subscriber_fd(NULL, &fd));
  REFUSES("fd", lot_subscriber_fd(ends.in, NULL));

  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  const lot_message* const message = lot_loan_message(loan);
  REFUSES("message", lot_message_keep(NULL, &none));
  REFUSES("kept", lot_message_keep(message, NULL));
  REFUSES("message", lot_get_kind(NULL, "", &kind));
  REFUSES("result", lot_get_kind(message, "", NULL));
  REFUSES("path", lot_get_kind(message, NULL, &kind));
  REFUSES("message", lot_get_count(NULL, "", &count));
  REFUSES("message", lot_get_int64(NULL, "", &whole));
  REFUSES("message", lot_get_uint64(NULL, "", &natural));
  REFUSES("message", lot_get_double(NULL, "", &real));
  REFUSES("message", lot_get_text(NULL, "", &view));
  REFUSES("message", lot_get_bytes(NULL, "", &view));
  REFUSES("message", lot_print(NULL, "", text, 1, &count));
  REFUSES("path", lot_print(message, NULL, text, 1, &count));
  REFUSES("needed", lot_print(message, "", text, 1, NULL));
  REFUSES("buffer", lot_print(message, "", NULL, 1, &count));
  CHECK(none == NULL && in == NULL && fd == -1 && count == 77);

  lot_engine_options options = {.segment = "a/b"};
  char* const segment = strdup(getenv("LOT_SEGMENT"));
  CHECK(unsetenv("LOT_SEGMENT") == 0);
  CHECK(lot_engine_open(&options, &engine) == -EINVAL && engine == NULL);
  CHECK(setenv("LOT_SEGMENT", segment, 1) == 0);
  free(segment);
  lot_loan_release(loan);
  close_ends(&ends);
}

static void a_long_error_is_cut(void) {
  struct ends ends = ends_of(point_type("point"), NULL);
  char topic[3001];
  memset(topic, 't', sizeof topic - 1);
  topic[sizeof topic - 1] = '\0';
  CHECK(lot_subscribe(ends.engine, topic, ends.type, NULL, &ends.in) == -EINVAL);
  CHECK(strlen(lot_error_object()) == 255 && strlen(lot_error_text()) == 1535);
  CHECK(strncmp(lot_error_object(), topic, 255) == 0 && strstr(lot_error_text(), "ttt") != NULL);
  CHECK(lot_subscribe(ends.engine, "", ends.type, NULL, &ends.in) == -EINVAL);
  CHECK(strlen(lot_error_object()) == 0 && strstr(lot_error_text(), "ttt") == NULL);
  const char* const texts[] = {
      "ok", "empty", "full", "timeout", "publisher gone", "holds too much", "stopped", "unknown"};
  for (int status = LOT_OK; status <= LOT_STOPPED + 1; ++status) {
    CHECK(strcmp(lot_status_text(status), texts[status]) == 0);
  }
  CHECK(strcmp(lot_status_text(-EPERM), "Operation not permitted") == 0);
  close_ends(&ends);
}

static void memory_that_the_segment_does_not_have_is_an_error(void) {
  struct ends ends = ends_of(box_type(), NULL);
  lot_loan* loan = NULL;
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  CHECK(lot_resize(loan, "scores", (size_t)1 << 40) == -ENOBUFS);
  CHECK(strstr(lot_error_text(), "LOT_SIZE") != NULL);
  fill_box(loan);
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK);
  close_ends(&ends);
}

/* ---- options ---- */

/* Opens and closes an engine. What the environment says comes first, so it says nothing. */
static int opened(const lot_engine_options* options) {
  lot_engine* engine = NULL;
  const int result = lot_engine_open(options, &engine);
  if (result == LOT_OK) lot_engine_close(engine);
  return result;
}

static long locked_kilobytes(void) {
  FILE* const file = fopen("/proc/self/status", "r");
  char line[200];
  long kilobytes = -1;
  CHECK(file != NULL);
  while (fgets(line, sizeof line, file) != NULL) sscanf(line, "VmLck: %ld", &kilobytes);
  fclose(file);
  return kilobytes;
}

static void each_option_of_an_engine_counts(void) {
  char directory[] = "/dev/shm/lot_c_test_XXXXXX";
  char path[64];
  char* const segment = strdup(getenv("LOT_SEGMENT"));
  char* const size = strdup(getenv("LOT_SIZE"));
  CHECK(mkdtemp(directory) != NULL);
  snprintf(path, sizeof path, "%s/own", directory);
  CHECK(unsetenv("LOT_SEGMENT") == 0 && unsetenv("LOT_SIZE") == 0);
  const lot_engine_options plain = {
      .segment = "own", .directory = directory, .size_bytes = 32 << 20, .permissions = 0606};
  lot_engine_options options = plain;
  lot_engine* engine = NULL;
  struct stat seen;
  CHECK(lot_engine_open(&plain, &engine) == LOT_OK);
  CHECK(strcmp(lot_engine_path(engine), path) == 0);
  CHECK(stat(path, &seen) == 0 && seen.st_size == 32 << 20 && (seen.st_mode & 0777) == 0606);
  lot_engine_close(engine);
  CHECK(access(path, F_OK) != 0);

  const struct {
    const char* name;
    uint32_t* option;
  } counts[] = {{"processes", &options.processes},
                {"blocks", &options.blocks},
                {"topics", &options.topics},
                {"channels", &options.channels},
                {"readers", &options.readers}};
  for (size_t i = 0; i < sizeof counts / sizeof *counts; ++i) {
    char object[64];
    snprintf(object, sizeof object, "EngineOptions::%s", counts[i].name);
    *counts[i].option = UINT32_MAX;
    REFUSES(object, opened(&options));
    *counts[i].option = 0;
  }
  options.group = "no such group";
  CHECK(opened(&options) < 0 && strstr(lot_error_text(), "no such group") != NULL);
  options.group = NULL;
  options.user = "no such user";
  CHECK(opened(&options) < 0 && strstr(lot_error_text(), "no such user") != NULL);

  options = plain;
  options.lock_memory = true;
  CHECK(locked_kilobytes() == 0);
  if (lot_engine_open(&options, &engine) == LOT_OK) { /* where a process may lock so much */
    CHECK(locked_kilobytes() > 0);
    lot_engine_close(engine);
  }
  options = plain;
  options.persist = true;
  CHECK(opened(&options) == LOT_OK && access(path, F_OK) == 0);
  CHECK(unlink(path) == 0);
  strcat(path, ".lock");
  unlink(path);
  CHECK(rmdir(directory) == 0);
  CHECK(setenv("LOT_SEGMENT", segment, 1) == 0 && setenv("LOT_SIZE", size, 1) == 0);
  free(segment);
  free(size);
}

static void each_option_of_an_end_counts(void) {
  lot_publisher_options out = lot_publisher_defaults();
  CHECK(out.policy == LOT_OVERWRITE && out.depth == 64 && out.block_for == LOT_SECOND);
  CHECK(out.engine == LOT_RING && out.max_bytes == 0 && out.history == UINT32_MAX && !out.stamp);
  lot_subscriber_options in = lot_subscriber_defaults();
  CHECK(in.wait == LOT_ADAPTIVE && in.history == 0 && in.max_held_bytes == 0 && !in.observer);
  out.max_bytes = 1 << 20;
  out.history = 2;
  struct ends ends = ends_of(box_type(), &out);
  lot_loan* loan = NULL;
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  CHECK(lot_resize(loan, "scores", 1 << 20) == -ENOBUFS); /* 4 MiB */
  CHECK(strstr(lot_error_text(), "max_bytes") != NULL);
  lot_loan_release(loan);
  for (size_t i = 0; i < 3; ++i) {
    CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
    CHECK(lot_resize(loan, "scores", 16384 + i) == LOT_OK);
    CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK);
    lot_message* read = NULL;
    CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &read) == LOT_OK);
    lot_message_release(read);
  }
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK); /* takes back what was read */
  lot_loan_release(loan);
  in.history = UINT64_MAX;
  in.observer = true;
  in.max_held_bytes = 1;
  lot_subscriber* late = NULL;
  lot_message* first = NULL;
  lot_message* second = NULL;
  size_t count = 0;
  CHECK(lot_subscribe(ends.engine, "/topic", ends.type, &in, &late) == LOT_OK);
  CHECK(lot_subscriber_size(late, &count) == LOT_OK && count == 2);       /* history */
  CHECK(lot_publisher_readers(ends.out, &count) == LOT_OK && count == 1); /* an observer is none */
  CHECK(lot_pull(late, LOT_NOW, NULL, &first) == LOT_OK);
  CHECK(lot_get_count(first, "scores", &count) == LOT_OK && count == 16385);
  CHECK(lot_pull(late, LOT_NOW, NULL, &second) == LOT_HOLDS_TOO_MUCH && second == NULL);
  lot_message_release(first);
  lot_subscriber_close(late);
  close_ends(&ends);

  lot_publisher_options wrong = lot_publisher_defaults();
  struct ends more = ends_of(point_type("point"), NULL);
  lot_publisher* none = NULL;
  wrong.depth = 0;
  CHECK(lot_advertise(more.engine, "/other", more.type, &wrong, &none) == -EINVAL && none == NULL);
  CHECK(strstr(lot_error_text(), "depth") != NULL);
  close_ends(&more);
}

static void the_elements_of_a_loan_are_written_where_they_lie(void) {
  struct ends ends = ends_of(box_type(), NULL);
  lot_loan* loan = NULL;
  void* data = NULL;
  size_t size = 0;
  double score = 0;
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  CHECK(lot_resize(loan, "scores", 3) == LOT_OK);
  CHECK(lot_loan_bytes(loan, "scores", &data, &size) == LOT_OK && size == 3 * sizeof(float));
  ((float*)data)[2] = 2.5F;
  CHECK(lot_get_double(lot_loan_message(loan), "scores[2]", &score) == LOT_OK && score == 2.5);
  CHECK(lot_message_data(lot_loan_message(loan)) == lot_loan_data(loan));
  lot_loan_release(loan);
  close_ends(&ends);
}

static void an_envelope_without_a_stamp_says_so_and_cuts_a_long_name(void) {
  const char* const name = "a name of a process that is much longer than any envelope has room for";
  const lot_engine_options naming = {.name = name};
  lot_engine* engine = NULL;
  CHECK(lot_engine_open(&naming, &engine) == LOT_OK);
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_envelope envelope;
  lot_message* message = NULL;
  push_point(ends.out, 1);
  CHECK(lot_borrow(ends.in, 1, NULL, &message) == LOT_OK); /* a nanosecond: it is there */
  CHECK(lot_subscriber_envelope(ends.in, &envelope) == LOT_OK && envelope.pushed == -1);
  CHECK(envelope.sequence == 0 && envelope.missed == 0);
  CHECK(strlen(envelope.publisher) > 20 && strlen(envelope.publisher) < sizeof envelope.publisher);
  CHECK(strncmp(envelope.publisher, name, strlen(envelope.publisher)) == 0);
  lot_message_release(message);
  CHECK(lot_borrow(ends.in, 1, NULL, &message) == LOT_TIMEOUT);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &message) == LOT_EMPTY);
  lot_engine_close(engine);
  close_ends(&ends);
}

/* ---- processes ---- */

static int code_of(pid_t child) {
  int status = 0;
  CHECK(waitpid(child, &status, 0) == child);
  return status;
}

static void handles_are_inert_in_a_forked_child(void) {
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_message* kept = NULL;
  lot_loan* loan = NULL;
  push_point(ends.out, 1);
  CHECK(lot_pull(ends.in, LOT_NOW, NULL, &kept) == LOT_OK);
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  const pid_t child = fork();
  CHECK(child >= 0);
  if (child == 0) {
    lot_message* message = NULL;
    lot_publisher* out = NULL;
    lot_loan* another = NULL;
    size_t count = 0;
    double x = 0;
    CHECK(lot_get_double(kept, "x", &x) == LOT_OK && x == 1); /* by the parent's hold */
    CHECK(lot_message_keep(kept, &message) == LOT_OK);
    lot_message_release(message);
    message = NULL;
    CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &message) == -ECHILD && message == NULL);
    CHECK(lot_publisher_push(ends.out, &loan, NULL) == -ECHILD && loan != NULL);
    CHECK(lot_publisher_loan(ends.out, &another) == -ECHILD && another == NULL);
    CHECK(lot_publisher_readers(ends.out, &count) == -ECHILD);
    CHECK(lot_advertise(ends.engine, "/topic", ends.type, NULL, &out) == -ECHILD);
    lot_loan_release(loan);
    lot_message_release(kept);
    close_ends(&ends);
    lot_engine* const own = open_engine(); /* one of its own works */
    lot_engine_close(own);
    _exit(0);
  }
  CHECK(code_of(child) == 0);
  CHECK(x_of(kept) == 1);
  CHECK(lot_publisher_push(ends.out, &loan, NULL) == LOT_OK);
  lot_message_release(kept);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &kept) == LOT_OK);
  lot_message_release(kept);
  close_ends(&ends);
}

/* What it has at its death: a loan, a borrow, a kept message; and what it has pushed. */
static void be_killed(int ready) {
  struct ends ends = ends_of(point_type("point"), NULL);
  lot_message* kept = NULL;
  lot_message* borrowed = NULL;
  lot_loan* loan = NULL;
  push_point(ends.out, 11);
  push_point(ends.out, 12);
  CHECK(lot_pull(ends.in, LOT_NOW, NULL, &kept) == LOT_OK);
  CHECK(lot_borrow(ends.in, LOT_NOW, NULL, &borrowed) == LOT_OK);
  CHECK(lot_publisher_loan(ends.out, &loan) == LOT_OK);
  CHECK(write(ready, "", 1) == 1);
  for (;;) pause();
}

static void a_killed_process_leaves_what_it_has_pushed(void) {
  lot_engine* const engine = open_engine();
  lot_type* const type = point_type("point");
  lot_subscriber* in = NULL;
  int ends[2];
  char byte;
  CHECK(lot_subscribe(engine, "/topic", type, NULL, &in) == LOT_OK);
  CHECK(pipe(ends) == 0);
  const pid_t child = fork();
  CHECK(child >= 0);
  if (child == 0) be_killed(ends[1]);
  CHECK(read(ends[0], &byte, 1) == 1);
  CHECK(kill(child, SIGKILL) == 0);
  CHECK(WIFSIGNALED(code_of(child)));
  for (int x = 11; x <= 12; ++x) {
    lot_message* message = NULL;
    CHECK(lot_pull(in, LOT_FOREVER, NULL, &message) == LOT_OK && x_of(message) == x);
    lot_message_release(message);
  }
  lot_message* none = NULL;
  CHECK(lot_pull(in, LOT_FOREVER, NULL, &none) == LOT_PUBLISHER_GONE);
  close(ends[0]);
  close(ends[1]);
  lot_subscriber_close(in);
  lot_type_release(type);
  lot_engine_close(engine);
}

static void signals_stop_waits_or_end_the_process(void) {
  CHECK(!lot_stop_requested(NULL));
  lot_stop_request(NULL);
  pid_t child = fork();
  CHECK(child >= 0);
  if (child == 0) {
    lot_stop* stop = NULL;
    CHECK(lot_stop_on_signals(&stop) == LOT_OK);
    lot_stop_request(stop); /* the signals alone stop it */
    CHECK(!lot_stop_requested(stop));
    struct ends ends = ends_of(point_type("point"), NULL);
    lot_message* message = NULL;
    CHECK(kill(getpid(), SIGTERM) == 0);
    while (!lot_stop_requested(stop)) usleep(1000);
    CHECK(lot_borrow(ends.in, LOT_FOREVER, stop, &message) == LOT_STOPPED && message == NULL);
    message = (lot_message*)(void*)&ends; /* it says that there is none */
    CHECK(lot_borrow(ends.in, LOT_NOW, stop, &message) == LOT_STOPPED && message == NULL);
    close_ends(&ends);
    lot_stop_release(stop);
    _exit(0);
  }
  CHECK(code_of(child) == 0);
  child = fork();
  CHECK(child >= 0);
  if (child == 0) {
    CHECK(lot_end_cleanly_on_signals() == LOT_OK);
    (void)open_engine();
    CHECK(kill(getpid(), SIGTERM) == 0);
    for (;;) pause();
  }
  const int status = code_of(child);
  CHECK(WIFSIGNALED(status) && WTERMSIG(status) == SIGTERM);
}

/* ---- all of them ---- */

struct test {
  const char* name;
  void (*body)(void);
};
#define TEST(name) \
  { #name, name }

static const struct test tests[] = {
    TEST(a_struct_lies_as_the_compiler_lays_it_out),
    TEST(a_type_goes_through_bytes),
    TEST(what_can_be_no_type_is_refused),
    TEST(fields_are_set_and_read_by_their_paths),
    TEST(a_topic_tells_its_type_to_a_program_without_it),
    TEST(an_opaque_message_begins_as_zeros),
    TEST(a_loan_that_is_released_is_not_published),
    TEST(one_borrow_at_a_time),
    TEST(handles_end_in_any_order),
    TEST(a_kept_message_does_not_hold_a_closed_subscriber),
    TEST(a_full_queue_leaves_the_loan_with_its_owner),
    TEST(a_wait_ends_in_time_by_its_stop_and_with_the_publisher),
    TEST(an_envelope_says_where_a_message_comes_from),
    TEST(each_thread_has_its_own_last_error),
    TEST(a_missing_argument_of_a_type_is_named),
    TEST(a_missing_argument_of_a_publisher_is_named),
    TEST(a_missing_argument_of_a_subscriber_is_named),
    TEST(a_long_error_is_cut),
    TEST(each_option_of_an_engine_counts),
    TEST(each_option_of_an_end_counts),
    TEST(the_elements_of_a_loan_are_written_where_they_lie),
    TEST(an_envelope_without_a_stamp_says_so_and_cuts_a_long_name),
    TEST(signals_stop_waits_or_end_the_process),
    TEST(memory_that_the_segment_does_not_have_is_an_error),
    TEST(handles_are_inert_in_a_forked_child),
    TEST(a_killed_process_leaves_what_it_has_pushed),
};

int main(int argc, char** argv) {
  setenv("LOT_SEGMENT", "lot_c_test", 0);
  setenv("LOT_SIZE", "64M", 1);
  for (size_t i = 0; i < sizeof tests / sizeof *tests; ++i) {
    bool wanted = argc < 2;
    for (int k = 1; k < argc; ++k) wanted = wanted || strstr(tests[i].name, argv[k]) != NULL;
    if (!wanted) continue;
    running = tests[i].name;
    tests[i].body();
    char path[300]; /* each ends as it began: without a file */
    snprintf(path, sizeof path, "/dev/shm/%s", getenv("LOT_SEGMENT"));
    CHECK(access(path, F_OK) != 0);
    printf("%s\n", running);
  }
  return 0;
}
