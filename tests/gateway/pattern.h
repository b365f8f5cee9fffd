/* SPDX-License-Identifier: Apache-2.0 */
/* What the frames of these tests have in them: each byte follows from its place and the frame's
 * number. For C and C++. */
#ifndef LOT_TESTS_GATEWAY_PATTERN_H
#define LOT_TESTS_GATEWAY_PATTERN_H

#include <stdint.h>

#include <stddef.h>

static inline uint8_t byte_of(uint32_t number, size_t i) {
  return (uint8_t)(number * 31u + i * 7u + i / 251u);
}
static inline void fill_pattern(uint8_t* data, size_t size, uint32_t number) {
  for (size_t i = 0; i < size; ++i) data[i] = byte_of(number, i);
}
/* The place of the first byte that is wrong; `size`: none is. */
static inline size_t first_wrong(const uint8_t* data, size_t size, uint32_t number) {
  size_t i = 0;
  while (i < size && data[i] == byte_of(number, i)) ++i;
  return i;
}

#endif
