/* SPDX-License-Identifier: Apache-2.0 */
#ifndef LOT_LOT_H
#define LOT_LOT_H

/*
 * LOT's interface in C11: docs/c.md says who owns what, and what a fork and a crash leave.
 *
 * Each function that can fail returns LOT_OK; or a status above 0, where nothing came of it in
 * ordinary life; or an error below 0: a value of errno, negated. lot_error_text() says what failed,
 * and what to do about it. A call that fails has changed nothing, and has written none of what it
 * gives.
 *
 * Threads: each function says which. What is not said: at once, from any thread, on different
 * handles.
 */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- results ---- */

enum {
  LOT_OK = 0,             /* it has done what it was asked for */
  LOT_EMPTY = 1,          /* nothing to read now */
  LOT_FULL = 2,           /* a slow reader holds the queue back, and the time is up */
  LOT_TIMEOUT = 3,        /* nothing came in time */
  LOT_PUBLISHER_GONE = 4, /* nothing to read, and the topic has no publisher now */
  LOT_HOLDS_TOO_MUCH = 5, /* the subscription keeps all the memory that it may: release messages */
  LOT_STOPPED = 6         /* the lot_stop was told to stop */
};

/* What the last call of this thread that returned an error has to say: never NULL, valid until the
 * next such call of the thread. "" before the first. */
const char* lot_error_text(void);
/* The topic, file or field that it is about, as above. */
const char* lot_error_object(void);
/* A status or an error in a few words, such as "publisher gone"; never NULL, valid for ever. */
const char* lot_status_text(int status);

/* ---- handles: each has one owner, which ends it by the function that is named ---- */

typedef struct lot_engine lot_engine;         /* lot_engine_close() */
typedef struct lot_type lot_type;             /* lot_type_release() */
typedef struct lot_publisher lot_publisher;   /* lot_publisher_close() */
typedef struct lot_loan lot_loan;             /* lot_loan_release(), or a push that says LOT_OK */
typedef struct lot_subscriber lot_subscriber; /* lot_subscriber_close() */
typedef struct lot_message lot_message;       /* lot_message_release() */
typedef struct lot_stop lot_stop;             /* lot_stop_release() */

/* Bytes in a message: not the program's own; valid as long as the handle that they came from. */
typedef struct lot_view {
  const void* data;
  size_t size;
} lot_view;

/* ---- time ---- */

/* A wait takes nanoseconds. Less than 0 is as 0. */
#define LOT_NOW INT64_C(0)    /* it looks once */
#define LOT_FOREVER INT64_MAX /* it has no limit */
#define LOT_SECOND INT64_C(1000000000)

/* Ends waits early: once it was told to stop, each call that has it returns LOT_STOPPED, for ever.
 * NULL in its place: nothing ends the wait. Errors: -ENOMEM. */
int lot_stop_new(lot_stop** stop);
/* One that SIGINT, SIGTERM and SIGHUP stop, for programs that end by returning from main(). A
 * signal that is ignored or has a handler is left alone. Errors: -ENOMEM. */
int lot_stop_on_signals(lot_stop** stop);
/* Stops it; one of lot_stop_on_signals() is left to the signals. At any time, also in a signal
 * handler. */
void lot_stop_request(lot_stop* stop);
/* Whether it was told to stop. At any time, also in a signal handler. */
bool lot_stop_requested(const lot_stop* stop);
/* Waits that have it go on with it. NULL: does nothing. */
void lot_stop_release(lot_stop* stop);
/* SIGINT, SIGTERM and SIGHUP end the process as by default, and the last process of a segment
 * leaves no file. Errors: -EAGAIN (no thread). */
int lot_end_cleanly_on_signals(void);

/* ---- engine ---- */

/* Which segment, and how it is made where there is none. NULL and 0: the default. What the
 * environment says (LOT_SEGMENT, LOT_DIR, LOT_SIZE ...: docs/api.md) comes first. */
typedef struct lot_engine_options {
  const char* segment;   /* "LOTROS" */
  const char* directory; /* "/dev/shm" */
  uint64_t size_bytes;   /* the segment's, or 1 GiB, or less where the system does not have that */
  unsigned permissions;  /* 0600, or 0660 with a group; 0606 and 0666 */
  const char* group;     /* a name or a number: its members share the segment */
  const char* user;      /* this user's segment is joined, too */
  bool persist;          /* the files stay when the last process leaves */
  bool lock_memory;      /* touched memory is never swapped out */
  const char* name;      /* what tools call this process: the program's name */
  uint32_t processes;    /* 319, of a new segment, as the rest */
  uint32_t blocks;       /* 16384 messages at once */
  uint32_t topics;       /* 1024 */
  uint32_t channels;     /* 2048 publishers */
  uint32_t readers;      /* 256 of one publisher */
} lot_engine_options;

/* Joins the segment, and makes it where there is none. options: NULL for the default. It waits for
 * a process that joins or leaves just now, five seconds at most. Several engines of a process on
 * one segment are one participant. Errors: as those of lot::ShmEngine (lot/engine.hpp): -EINVAL,
 * -EPERM, -EBUSY, -EUSERS, -ENOSPC ... */
int lot_engine_open(const lot_engine_options* options, lot_engine** engine);
/* Publishers, subscribers and messages stay as they are. NULL: does nothing. */
void lot_engine_close(lot_engine* engine);
/* The file that the segment is: valid as long as the engine. */
const char* lot_engine_path(const lot_engine* engine);

/* ---- types ---- */

/* What a value is: as lot::Kind. */
typedef enum lot_kind {
  LOT_KIND_OPAQUE = 0,
  LOT_KIND_BOOL = 1,
  LOT_KIND_CHAR = 2,
  LOT_KIND_INT = 3,
  LOT_KIND_UINT = 4,
  LOT_KIND_FLOAT = 5,
  LOT_KIND_ENUM = 6,
  LOT_KIND_DURATION = 7,
  LOT_KIND_TIME_POINT = 8,
  LOT_KIND_ARRAY = 9,
  LOT_KIND_STRUCT = 10,
  LOT_KIND_STRING = 11,
  LOT_KIND_VECTOR = 12,
  LOT_KIND_REFERENCE = 13
} lot_kind;

typedef struct lot_field {
  const char* name; /* NULL or "": it has none */
  const lot_type* type;
} lot_field;

/* Types that a program makes. They lie as the compiler lays the C++ type out, and of numbers alone
 * as that of C does. They meet a C++ type of that name, layout and field names. What they are made
 * of stays the caller's. Errors of all: -EINVAL for what cannot be, or is too large for a
 * description (16 KiB); -ENOMEM. */

/* A bool, char, integer or float of so many bytes. */
int lot_type_number(lot_kind kind, size_t size, lot_type** type);
/* lot::ShmString */
int lot_type_string(lot_type** type);
/* lot::ShmVector */
int lot_type_vector(const lot_type* element, lot_type** type);
/* std::array, or an array of C */
int lot_type_array(const lot_type* element, size_t count, lot_type** type);
/* lot::ShmRef. A loan's references refer to nothing. */
int lot_type_reference(const lot_type* target, lot_type** type);
/* An enum that lies as that integer. */
int lot_type_enum(const char* name, const lot_type* number, lot_type** type);
/* std::chrono::duration: numerator / denominator seconds are one. */
int lot_type_duration(const lot_type* number, int64_t numerator, int64_t denominator,
                      lot_type** type);
/* A time point of "system_clock" or "steady_clock". */
int lot_type_time_point(const char* clock, const lot_type* duration, lot_type** type);
/* A struct of these fields, in this order. name: that of C++, with its namespaces. */
int lot_type_struct(const char* name, const lot_field* fields, size_t count, lot_type** type);
/* So many bytes that only the type's own programs understand. */
int lot_type_opaque(const char* name, size_t size, size_t alignment, lot_type** type);
/* The type that lot_type_encode() told; the bytes need not be trusted. hash: TypeIdentity::hash(),
 * mostly 0. */
int lot_type_decode(const char* name, size_t alignment, lot_view bytes, uint64_t hash,
                    lot_type** type);

/* What a topic carries. Errors: -ENOENT where no process uses it; -EBADMSG, -EBUSY as
 * lot_subscribe(). */
int lot_type_of_topic(lot_engine* engine, const char* topic, lot_type** type);
/* Another handle of the same type. Errors: -ENOMEM. */
int lot_type_copy(const lot_type* type, lot_type** copy);
/* NULL: does nothing. */
void lot_type_release(lot_type* type);

/* All of these at once, from any thread. Texts are valid as long as the type. */

const char* lot_type_name(const lot_type* type);
/* Of a message, without what its vectors and strings have. */
size_t lot_type_size(const lot_type* type);
size_t lot_type_alignment(const lot_type* type);
/* Whether a message of the one may be read as one of the other: as both ends of a topic are
 * compared. Errors: -ENOMEM. */
int lot_type_is_same(const lot_type* a, const lot_type* b, bool* is_same);
/* These fail with -EBADMSG where another process has damaged what a topic says of its type. */

int lot_type_kind(const lot_type* type, lot_kind* kind);
/* Hashes of the layout, and of the names of fields (0: some have none). */
int lot_type_hashes(const lot_type* type, uint64_t* layout, uint64_t* names);
/* Elements of an array, fields of a struct; else 0. */
int lot_type_count(const lot_type* type, size_t* count);
/* A field of a struct, by its place; what is NULL is not told. *type is the caller's. Errors:
 * -EINVAL where there is none; -ENOMEM. */
int lot_type_field(const lot_type* whole, size_t place, const char** name, size_t* offset,
                   lot_type** type);
/* What an array, vector, reference, enum, duration or time point has; *element is the caller's.
 * Errors: -EINVAL for another; -ENOMEM. */
int lot_type_element(const lot_type* type, lot_type** element);
/* The description as bytes (docs/layout.md): valid as long as the type; none where it is too large.
 * Errors: -ENOMEM. */
int lot_type_encode(const lot_type* type, lot_view* bytes);

/* ---- publish ---- */

typedef enum lot_policy { LOT_OVERWRITE = 0, LOT_BLOCK = 1, LOT_REFUSE = 2 } lot_policy;
typedef enum lot_queue_engine { LOT_RING = 0, LOT_MUTEX = 1 } lot_queue_engine;

/* As lot::PusherOptions. Begin with lot_publisher_defaults(). */
typedef struct lot_publisher_options {
  lot_policy policy;       /* LOT_OVERWRITE */
  uint32_t depth;          /* 64 */
  int64_t block_for;       /* LOT_SECOND: so long a push and a loan wait under LOT_BLOCK */
  lot_queue_engine engine; /* LOT_RING */
  uint64_t max_bytes;      /* 0: as much as the segment has */
  uint32_t history;        /* UINT32_MAX: all that the queue has room for */
  bool stamp;              /* false; true: each push notes its time */
} lot_publisher_options;
lot_publisher_options lot_publisher_defaults(void);

/* A publisher of the topic. options: NULL for the default. Errors: -EPROTOTYPE when the topic
 * carries another type; -EINVAL, -ENOSPC, -EUSERS, -EBUSY, -EBADMSG, -ENOBUFS as
 * ShmEngine::advertise(). */
int lot_advertise(lot_engine* engine, const char* topic, const lot_type* type,
                  const lot_publisher_options* options, lot_publisher** publisher);
/* Its loans stay as they are, and readers read what was pushed. NULL: does nothing. */
void lot_publisher_close(lot_publisher* publisher);
/* The topic's: valid as long as the publisher, and not to be released. */
const lot_type* lot_publisher_type(const lot_publisher* publisher);

/* A new message: numbers are 0, strings and vectors empty; one that is opaque as a whole is zero
 * bytes. Under LOT_BLOCK it waits up to block_for for memory. Errors: -ENOBUFS when the segment has
 * no room; -EINVAL when a part of the type is opaque; -ECHILD, -ESTALE. */
int lot_publisher_loan(lot_publisher* publisher, lot_loan** loan);
/* Publishes. LOT_OK: *loan is ended, and NULL. LOT_FULL (after block_for under LOT_BLOCK, at once
 * under LOT_REFUSE), LOT_STOPPED and errors leave it as it was. Errors: -EINVAL for a loan of
 * another type; -ECHILD, -ESTALE, -EBUSY. */
int lot_publisher_push(lot_publisher* publisher, lot_loan** loan, lot_stop* stop);
/* The same with another limit than the options'. */
int lot_publisher_push_for(lot_publisher* publisher, lot_loan** loan, int64_t block_for,
                           lot_stop* stop);
/* Publishes a message that was received, without a copy; it stays the caller's. It waits, and says
 * LOT_FULL and LOT_STOPPED, as above. Errors: -EINVAL for a message of another type; -EDQUOT where
 * a borrowed one may not be kept; as above. */
int lot_publisher_forward(lot_publisher* publisher, const lot_message* message, lot_stop* stop);
/* Subscribers that read it. Errors: -ECHILD, -ESTALE. */
int lot_publisher_readers(lot_publisher* publisher, size_t* count);
/* Waits until so many do: LOT_OK; else LOT_TIMEOUT or LOT_STOPPED. Errors: -ECHILD, -ESTALE. */
int lot_publisher_wait_for_readers(lot_publisher* publisher, size_t count, int64_t timeout,
                                   lot_stop* stop);
/* Makes memory for so many messages, with so many bytes of vectors and strings each. Errors:
 * -ENOBUFS. */
int lot_publisher_reserve(lot_publisher* publisher, size_t count, size_t bytes);

/* One thread at a time builds a loan. A path is "width", "labels[2].name", or "" for the whole.
 * Errors of all: -EINVAL for a path that is not there and a value of the wrong kind; -ERANGE for
 * what does not fit; -ENOBUFS where a message cannot grow; -ECHILD. */

/* The whole, as lot_type_size() bytes, where the message lies: valid until the push or the release.
 */
void* lot_loan_data(lot_loan* loan);
/* The same message, to be read: valid as long as the loan, and not to be released. */
const lot_message* lot_loan_message(const lot_loan* loan);
/* A number, bool, char, enum, or the count of a duration or time point. */
int lot_set_int64(lot_loan* loan, const char* path, int64_t value);
int lot_set_uint64(lot_loan* loan, const char* path, uint64_t value);
int lot_set_double(lot_loan* loan, const char* path, double value);
/* A string, or an array of char, whose rest is zero. */
int lot_set_text(lot_loan* loan, const char* path, const char* text, size_t size);
/* Gives a vector so many elements; those that come are zero, or empty. */
int lot_resize(lot_loan* loan, const char* path, size_t count);
/* Gives a vector of numbers these bytes for elements, or an array. */
int lot_set_bytes(lot_loan* loan, const char* path, lot_view bytes);
/* Where the elements of a vector or an array lie, to be written: valid until the message grows, or
 * ends. */
int lot_loan_bytes(lot_loan* loan, const char* path, void** data, size_t* size);
/* The message is gone, unpublished. NULL: does nothing. */
void lot_loan_release(lot_loan* loan);

/* ---- subscribe ---- */

typedef enum lot_wait { LOT_SPIN = 0, LOT_ADAPTIVE = 1, LOT_PARK = 2 } lot_wait;

/* As lot::PullerOptions. Begin with lot_subscriber_defaults(). */
typedef struct lot_subscriber_options {
  lot_wait wait;           /* LOT_ADAPTIVE */
  uint64_t history;        /* 0: how many of each publisher's messages of before come first */
  uint64_t max_held_bytes; /* 0: a quarter of the segment; UINT64_MAX: no limit */
  bool observer;           /* false; true: it looks on, and no publisher waits for it */
} lot_subscriber_options;
lot_subscriber_options lot_subscriber_defaults(void);

/* Subscribes to messages of that type; NULL: of what the topic carries. options: NULL for the
 * default. Errors: -ENOENT without a type where no process uses the topic; -EPROTOTYPE when it
 * carries another type; -EINVAL, -ENOSPC, -EUSERS, -EBUSY, -EBADMSG as ShmEngine::subscribe_any().
 */
int lot_subscribe(lot_engine* engine, const char* topic, const lot_type* type,
                  const lot_subscriber_options* options, lot_subscriber** subscriber);
/* Its messages stay as they are. NULL: does nothing. */
void lot_subscriber_close(lot_subscriber* subscriber);
/* The topic's: valid as long as the subscriber, and not to be released. */
const lot_type* lot_subscriber_type(const lot_subscriber* subscriber);

/* One thread at a time uses a subscriber, and its borrowed message. */

/* The next message, to be read here and now: cheaper than a pull. One at a time: -EBUSY until it is
 * released. LOT_EMPTY (of LOT_NOW), LOT_TIMEOUT, LOT_PUBLISHER_GONE or LOT_STOPPED: there is none,
 * and *message is NULL. A wait ends once when the last publisher has gone. Errors: -EBADMSG for a
 * damaged message, which counts as missed; -ECHILD, -ESTALE, -EBUSY, -ENOMEM. */
int lot_borrow(lot_subscriber* subscriber, int64_t timeout, lot_stop* stop, lot_message** message);
/* The same, to be kept: LOT_HOLDS_TOO_MUCH as well. */
int lot_pull(lot_subscriber* subscriber, int64_t timeout, lot_stop* stop, lot_message** message);

/* Where a message comes from: as lot::Envelope. */
typedef struct lot_envelope {
  uint64_t sequence;     /* 0 for the first of its publisher */
  uint64_t missed;       /* messages that this subscriber missed just before it */
  uint64_t publisher_id; /* tells publishers apart; 0: there is no message yet */
  int64_t pushed;        /* ns of CLOCK_MONOTONIC; -1: its publisher does not stamp */
  char publisher[48];    /* the name of its process */
} lot_envelope;
/* Of the last message that the subscriber got. Errors: -ECHILD, -ESTALE. */
int lot_subscriber_envelope(lot_subscriber* subscriber, lot_envelope* envelope);
/* Messages lost to it in all. */
uint64_t lot_subscriber_missed(const lot_subscriber* subscriber);
/* Publishers of the topic; messages that are there to be read. Errors: -ECHILD, -ESTALE, -EBUSY. */
int lot_subscriber_publishers(lot_subscriber* subscriber, size_t* count);
int lot_subscriber_size(lot_subscriber* subscriber, size_t* count);
/* A descriptor for poll and epoll: readable until a look with LOT_NOW has found nothing. It is the
 * subscriber's: do not close it. Errors: -EMFILE, -ENFILE, -ENOMEM, -EAGAIN, -ECHILD, -ESTALE. */
int lot_subscriber_fd(lot_subscriber* subscriber, int* fd);

/* ---- read ---- */

/* Another handle of the message, which keeps it. Errors: -EDQUOT when the subscription keeps all
 * that it may; -EINVAL for a loan; -ENOBUFS, -ECHILD, -ESTALE. */
int lot_message_keep(const lot_message* message, lot_message** kept);
/* Views of it end. NULL: does nothing. */
void lot_message_release(lot_message* message);
/* Where it lies, lot_type_size() bytes: for a program that has the type as a struct. */
const void* lot_message_data(const lot_message* message);
/* Valid as long as the message, and not to be released. */
const lot_type* lot_message_type(const lot_message* message);

/* Any number of threads may read a message. A path is "width", "labels[2].name", or "" for the
 * whole; without names, fields are _0, _1, ... A reference stands for what it refers to. Errors of
 * all: -EINVAL for a path that is not there, a value of another kind, and a reference to nothing;
 * -ERANGE where a number does not fit; -EBADMSG for a damaged message. */

int lot_get_kind(const lot_message* message, const char* path, lot_kind* kind);
/* Fields, elements, or bytes of text. */
int lot_get_count(const lot_message* message, const char* path, size_t* count);
/* A number, bool, char, enum, or the count of a duration or time point. */
int lot_get_int64(const lot_message* message, const char* path, int64_t* value);
int lot_get_uint64(const lot_message* message, const char* path, uint64_t* value);
int lot_get_double(const lot_message* message, const char* path, double* value);
/* The text of a string; no zero byte need follow. */
int lot_get_text(const lot_message* message, const char* path, lot_view* text);
/* The bytes as they lie: of a vector or an array its elements. */
int lot_get_bytes(const lot_message* message, const char* path, lot_view* bytes);
/* The value as a line of text for people, cut to size - 1 bytes and ended by a zero; *needed: how
 * many it would have, without the zero. */
int lot_print(const lot_message* message, const char* path, char* buffer, size_t size,
              size_t* needed);

#ifdef __cplusplus
}
#endif

#endif /* LOT_LOT_H */
