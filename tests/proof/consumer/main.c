/* SPDX-License-Identifier: Apache-2.0
 *
 * A program in C that uses the installed package. */
#include <stdio.h>

#include <lot/lot.h>

static int fail(const char* what) {
  fprintf(stderr, "%s: %s\n", what, lot_error_text());
  return 1;
}

int main(void) {
  lot_engine* engine = NULL;
  lot_type* type = NULL;
  lot_publisher* out = NULL;
  lot_subscriber* in = NULL;
  lot_loan* loan = NULL;
  lot_message* message = NULL;
  double value = 0;
  if (lot_engine_open(NULL, &engine) < 0) return fail("engine");
  if (lot_type_number(LOT_KIND_FLOAT, 8, &type) < 0) return fail("type");
  if (lot_advertise(engine, "/number", type, NULL, &out) < 0) return fail("advertise");
  if (lot_subscribe(engine, "/number", NULL, NULL, &in) < 0) return fail("subscribe");
  if (lot_publisher_loan(out, &loan) < 0) return fail("loan");
  if (lot_set_double(loan, "", 2.5) < 0) return fail("set");
  if (lot_publisher_push(out, &loan, NULL) != LOT_OK) return fail("push");
  if (lot_borrow(in, LOT_SECOND, NULL, &message) != LOT_OK) return fail("borrow");
  if (lot_get_double(message, "", &value) < 0) return fail("get");
  lot_message_release(message);
  lot_subscriber_close(in);
  lot_publisher_close(out);
  lot_type_release(type);
  lot_engine_close(engine);
  printf("in C: %g\n", value);
  return value == 2.5 ? 0 : 1;
}
