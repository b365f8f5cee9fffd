// SPDX-License-Identifier: Apache-2.0
/* Many sleepers on one word: a push wakes two of them, and two ways wake the rest. Each is enough by itself.
 *
 * A reader that was woken passes the wake-up on, and the rouser, a thread of the publisher's process, wakes all
 * that are left. Readers sleep on the slot of their ring. The publisher is killed, with its rouser, after any step,
 * or stands still behind its wake of two; a reader is killed after any step, which is for the others as if it stood
 * still. A sleep may end without a wake, once. A lost wake is an invalid end state: a reader sleeps beside a message.
 *
 * The kernel wakes the oldest sleeper first. Everything is sequentially consistent here. What else there is to
 * sleeping, sleep_wake.pml has.
 *
 * run both -DMESSAGES=2 -DDEPTH=2 : three readers, two messages in two slots
 * run passing_on -DNO_ROUSER -DMESSAGES=2 -DTIMES_OUT : no rouser; readers of the next message sleep on the same word
 * run four -DNO_ROUSER -DREADERS=4 : the same with four readers
 * run rousing -DNO_PASSING_ON -DTIMES_OUT : no reader passes anything on
 * run threads -DNO_PASSING_ON -DPUSHERS=2 -DREADERS=2 -DWAKES=0 -DMAY_NOT_START : two threads ask the rouser at once, and it may not start
 * run reader_killed -DMORTAL_READERS=1 : a reader is killed, perhaps with a wake-up that it has not passed on
 * run publisher_killed -DMORTAL_PUBLISHER -DNO_ROUSER -DMORTAL_READERS=1 : the publisher is killed, and perhaps a reader
 * run rouser_killed -DMORTAL_PUBLISHER -DNO_PASSING_ON -DREADERS=2 -DWAKES=1 : the publisher is killed, with its rouser; a push wakes one of two
 * run publisher_stands -DSTANDS -DTIMES_OUT : the publisher stands still behind its wake of two
 * run quiet -DQUIET -DNO_ROUSER -DTIMES_OUT : sleepers do not wake each other for ever
 * full readers_killed -DMORTAL_READERS=2 : two readers of three are killed
 *
 * pan -DNFAIR=3 -DCOLLAPSE
 *
 * plant NO_DUTY passing_on : a reader that was woken passes nothing on
 * plant WAKES_ONE passing_on : a push wakes one, which may be the one that has found no mark
 * plant ANY_MARK_IS_OWN passing_on : a reader that has left a mark once takes each mark of the slot for its own
 * plant ROUSER_IS_NOT_ASKED reader_killed : the push leaves the rest to the readers
 * plant ROUSER_LOOKS_ONCE threads : the rouser does not look again once it has said that it sleeps
 * plant FAILED_START_FORGETS threads : where the rouser does not start, what others have noted is forgotten
 * plant BELL_BEFORE_NOTE threads : the rouser is woken first, and then told why
 * plant REAPER_TRUSTS_MARKS publisher_killed : the reaper wakes only where it finds a mark
 * plant PASSES_ON_AT_ONCE quiet : a reader passes on whether the word has changed or not
 */

#ifndef PUSHERS
#define PUSHERS 1
#endif
#ifndef READERS
#define READERS 3
#endif
#ifndef DEPTH
#define DEPTH 1
#endif
#ifndef MESSAGES
#define MESSAGES 1
#endif
#ifndef MORTAL_READERS
#define MORTAL_READERS 0 /* how many may be killed */
#endif
#ifndef WAKES
#ifdef WAKES_ONE
#define WAKES 1
#else
#define WAKES 2 /* futex::kWakes */
#endif
#endif

/* Pusher c writes ring c. Reader r reads ring r % PUSHERS. */
#define RING(r) ((r) % PUSHERS)
/* A slot: the sequence, the round and the sleeper's mark. Sequences begin with DEPTH. */
#define MARK 1
#define ROUND 2
#define SEQUENCE(w) ((w) >> 2)
#define MAKE(sequence) ((sequence) << 2)
#define CLEARED(w) ((w) & MARK -> (w) & ~(MARK | ROUND) | (w) + ROUND & ROUND : (w))
#define SLOTS (PUSHERS * DEPTH)
#define SLOT(c, s) ((c) * DEPTH + (s) % DEPTH)
#define FIRST DEPTH
/* What the rouser does. */
#define ABSENT 0
#define AWAKE 1
#define ASLEEP 2
#define ALL 255

/* shared */
byte slot[SLOTS];
bit orphan;
bit noted[SLOTS]; /* the rouser's places: the slots that it is to wake */
byte state;       /* and what it does */

/* kernel */
chan line = [READERS] of { byte }; /* the sleepers, the oldest first */
byte queued[READERS];              /* on which slot, from 1; 0: on none */
bit woken[READERS];
bit rouser_sleeps;

/* ghost */
bit starts;  /* the rouser's thread */
bit dead;    /* the publisher, with its rouser */
bit stands;
bit killed[READERS];
bit ended[READERS];
byte published[PUSHERS];
byte done;   /* pushers that have ended */
byte deaths;
bit timed_out;

/* Wakes `most` of the oldest sleepers of a word. */
inline kernel_wake(futex, most) {
  d_step {
    n = len(line);
    do
    :: n > 0 ->
      n--;
      line ? q;
      if
      :: queued[q] == (futex) + 1 && woke < (most) -> queued[q] = 0; woken[q] = 1; woke++
      :: else -> line ! q
      fi
    :: else -> break
    od;
    q = 0
  }
}

inline kernel_wake_all(futex) { atomic { kernel_wake(futex, ALL); woke = 0 } }

/* A reader is on no queue any more. */
inline kernel_leave(r) {
  d_step {
    n = len(line);
    do
    :: n > 0 ->
      n--;
      line ? q;
      if
      :: q == (r)
      :: else -> line ! q
      fi
    :: else -> break
    od;
    queued[r] = 0;
    woken[r] = 0;
    q = 0
  }
}

/* ---- the rouser -------------------------------------------------------------------------------- */

inline wake_noted() {
  do
  :: atomic { i < SLOTS && !noted[i] -> i++ } /* @ src/transport/rouser.cpp wake_noted: if (place.load(std::memory_order_seq_cst) == nullptr) continue */
  :: atomic { i < SLOTS && noted[i] -> noted[i] = 0 }; /* @ src/transport/rouser.cpp wake_noted: const void* const word = place.exchange(nullptr */
    kernel_wake_all(i); /* @ src/transport/rouser.cpp wake_noted: if (word != nullptr) futex::wake_all(word) */
    i++
  :: atomic { i == SLOTS -> i = 0; break }
  od
}

proctype rouser() {
  byte i, n, q, woke;
  {
end_absent:
    do
    :: starts -> break
    od;
work:
    wake_noted();
    state = ASLEEP; /* @ src/transport/rouser.cpp run: if (!state_.compare_exchange_strong(is, kAsleep */
#ifndef ROUSER_LOOKS_ONCE
    do
    :: atomic { i < SLOTS && noted[i] -> i = 0; goto up } /* @ src/transport/rouser.cpp has_notes: return place.load(std::memory_order_seq_cst) != nullptr */
    :: atomic { i < SLOTS && !noted[i] -> i++ } /* @ src/transport/rouser.cpp has_notes: return place.load(std::memory_order_seq_cst) != nullptr */
    :: atomic { i == SLOTS -> i = 0; break }
    od;
#endif
    atomic {
      if
      :: state == ASLEEP -> rouser_sleeps = 1 /* @ src/transport/rouser.cpp run: if (!has_notes()) futex::wait(&state_, kAsleep */
      :: else -> goto up
      fi
    };
end_asleep:
    !rouser_sleeps;
up:
    atomic {
      if
      :: state == ASLEEP -> state = AWAKE /* @ src/transport/rouser.cpp run: (void)state_.compare_exchange_strong(is, kAwake */
      :: else
      fi;
      goto work
    }
  } unless { d_step { dead -> i = 0; woke = 0 } }
}

inline note(s) {
  noted[s] = 1 /* @ src/transport/rouser.cpp note: place.compare_exchange_strong(there, word */
}

inline rouse(s) {
#ifndef BELL_BEFORE_NOTE
  if
  :: note(s) /* @ src/transport/rouser.cpp rouse: if (!note(word)) */
  :: kernel_wake_all(s); goto roused /* @ src/transport/rouser.cpp rouse: return futex::wake_all(word) */
  fi;
#endif
  is = state; /* @ src/transport/rouser.cpp rouse: std::uint32_t is = state_.load */
  if
  :: is == AWAKE -> goto roused /* @ src/transport/rouser.cpp rouse: if (is == kAwake) return */
  :: else
  fi;
  atomic {
    if
    :: state == is -> state = AWAKE /* @ src/transport/rouser.cpp rouse: if (!state_.compare_exchange_strong(is, kAwake */
    :: else -> goto roused
    fi
  };
  if
  :: is == ASLEEP -> rouser_sleeps = 0 /* @ src/transport/rouser.cpp rouse: futex::wake_one(&state_) */
  :: is == ABSENT -> starts = 1 /* @ src/transport/rouser.cpp start: thread_ = std::thread([this] { run(); }) */
#ifdef MAY_NOT_START
  :: is == ABSENT -> state = ABSENT; /* @ src/transport/rouser.cpp start: state_.store(kAbsent */
#ifndef FAILED_START_FORGETS
    wake_noted() /* @ src/transport/rouser.cpp start: wake_noted() */
#endif
#endif
  fi;
roused:
#ifdef BELL_BEFORE_NOTE
  noted[s] = 1;
#endif
  is = 0
}

/* ---- a thread that pushes ---------------------------------------------------------------------- */

proctype pusher(byte c) {
  byte next, old, is, i, n, q, woke;
  {
    next = FIRST;
    do
    :: next < FIRST + MESSAGES ->
      atomic {
        old = slot[SLOT(c, next)]; /* @ src/lockfree_ring/ring.hpp publish: const Word old = slot.exchange(make(next_, block) */
        slot[SLOT(c, next)] = MAKE(next); /* @ src/lockfree_ring/ring.hpp publish: const Word old = slot.exchange(make(next_, block) */
        published[c]++
      };
      if
      :: old & MARK ->
        kernel_wake(SLOT(c, next), WAKES); /* @ src/transport/pusher.cpp wake_readers: if (futex::wake(word, futex::kWakes) == futex::kWakes) */
#ifdef STANDS
        if
        :: stands = 1; goto end_stands
        :: true
        fi;
#endif
#ifndef NO_ROUSER
#ifndef ROUSER_IS_NOT_ASKED
        if
        :: woke == WAKES -> rouse(SLOT(c, next)) /* @ src/transport/pusher.cpp wake_readers: participant_->rouser().rouse(word) */
        :: else
        fi
#endif
#endif
      :: else
      fi;
      atomic { old = 0; woke = 0; next++ }
    :: else -> break
    od;
    atomic { next = 0; done++; goto over };
end_stands:
    false;
over:
    skip
  } unless { d_step { dead -> next = 0; old = 0; is = 0; i = 0; woke = 0 } }
}

/* ---- a reader ---------------------------------------------------------------------------------- */

#define ALL_READ (cursor == FIRST + published[RING(r)])
/* Sleeping for ever is right only when all is read and nothing can come any more. */
#define NOTHING_CAN_COME (ALL_READ && !dead && (done == PUSHERS || stands))

proctype reader(byte r) {
  byte cursor, w, own, n, q, woke;
  bit stood;
  {
    cursor = FIRST;
look:
    /* The look that finds nothing, and the mark's load behind it, are one step here. */
    atomic {
      w = slot[SLOT(RING(r), cursor)]; /* @ src/lockfree_ring/ring.hpp mark_sleeping: Word seen = slot.load */
      if
      :: SEQUENCE(w) >= cursor -> cursor = SEQUENCE(w) + 1; w = 0; goto look
#ifdef MORTAL_PUBLISHER
      :: SEQUENCE(w) < cursor && orphan -> assert(ALL_READ); w = 0; goto finished /* @ src/lockfree_ring/ring.hpp ended: orphaned() && */
      :: SEQUENCE(w) < cursor && !orphan -> stood = w & MARK /* @ src/lockfree_ring/ring.hpp ended: orphaned() && */
#else
      :: else -> stood = w & MARK
#endif
      fi
    };
    atomic {
      if
      :: stood
      :: !stood && slot[SLOT(RING(r), cursor)] == w -> /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
        w = w | MARK;
        slot[SLOT(RING(r), cursor)] = w /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
      :: else -> w = 0; goto look
      fi;
      /* FutexWaits::push_back_marked() */
#ifdef ANY_MARK_IS_OWN
      stood = stood && own == 0;
#else
      stood = stood && own != w;
#endif
      own = (stood -> 0 : w)
    };
#ifdef MORTAL_PUBLISHER
    if
    :: orphan -> atomic { w = 0; stood = 0; goto look } /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
    :: !orphan /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
    fi;
#endif
    atomic {
      if
      :: slot[SLOT(RING(r), cursor)] == w -> queued[r] = SLOT(RING(r), cursor) + 1; line ! r /* @ src/waiting/waiting.hpp sleep: const bool in_time = futex::wait_any(words, until) */
      :: else -> goto awake
      fi
    };
    if
    :: atomic { woken[r] -> woken[r] = 0; if :: !stood -> w = 0; goto look :: else fi } /* @ src/waiting/waiting.hpp pass_on: if (!wait.is_shared) continue */
    :: NOTHING_CAN_COME && queued[r] -> atomic { kernel_leave(r); w = 0; stood = 0; goto finished }
#ifdef TIMES_OUT
    :: atomic { queued[r] && !timed_out -> timed_out = 1; kernel_leave(r) } /* @ src/waiting/waiting.hpp sleep: const bool in_time = futex::wait_any(words, until) */
#endif
    fi;
awake:
#ifndef NO_DUTY
#ifndef NO_PASSING_ON
    if
#ifdef PASSES_ON_AT_ONCE
    :: stood -> atomic { kernel_wake(SLOT(RING(r), cursor), WAKES); woke = 0 }
#else
    :: atomic { stood && slot[SLOT(RING(r), cursor)] != w -> skip }; /* @ src/waiting/waiting.hpp pass_on: if (__atomic_load_n(word, __ATOMIC_RELAXED) == wait.value) continue */
      atomic { kernel_wake(SLOT(RING(r), cursor), WAKES); woke = 0 } /* @ src/waiting/waiting.hpp pass_on: futex::wake(wait.word, futex::kWakes) */
    :: stood && slot[SLOT(RING(r), cursor)] == w /* @ src/waiting/waiting.hpp pass_on: if (__atomic_load_n(word, __ATOMIC_RELAXED) == wait.value) continue */
#endif
    :: !stood /* @ src/waiting/waiting.hpp pass_on: if (!wait.is_shared) continue */
    fi;
#endif
#endif
    atomic { w = 0; stood = 0; goto look };
finished:
    atomic { ended[r] = 1; own = 0; cursor = 0 }
  } unless { d_step { killed[r] -> cursor = 0; w = 0; own = 0; woke = 0; stood = 0 } }
}

/* ---- fate -------------------------------------------------------------------------------------- */

/* Kills, or loses the wish to. All readers are alike: it kills the first ones. */
proctype kernel_fate() {
  byte n, q;
  do
#ifdef MORTAL_PUBLISHER
  :: atomic { !dead -> dead = 1; rouser_sleeps = 0; starts = 0 }
#endif
  :: atomic { deaths < MORTAL_READERS && !ended[deaths] -> killed[deaths] = 1; kernel_leave(deaths); deaths++ }
#ifdef NO_ROUSER
  :: deaths == 0 || dead -> break /* else the reaper has to come: only the rouser would do without it */
#else
  :: break
#endif
  od
}

proctype reaper() {
  byte i, n, q, woke;
  bit marked[SLOTS];
end_idle:
  dead;
  orphan = 1; /* @ src/recovery/recovery.hpp orphan_ring: writer.end(generation, k) */
  do
  :: atomic { i < SLOTS ->
      marked[i] = slot[i] & MARK; /* @ src/lockfree_ring/ring.hpp clear_sleepers: clear_sleeper(slots[i]) */
      slot[i] = CLEARED(slot[i]); /* @ src/lockfree_ring/ring.hpp clear_sleepers: clear_sleeper(slots[i]) */
      i++ }
  :: atomic { i == SLOTS -> i = 0; break }
  od;
  do
#ifdef REAPER_TRUSTS_MARKS
  :: i < SLOTS && !marked[i] -> i++
  :: i < SLOTS && marked[i] ->
#else
  :: i < SLOTS ->
#endif
    kernel_wake_all(i); /* @ src/recovery/recovery.hpp wake_readers: r.wake_sleepers([this](auto& word) { world_.wake(word); }) */
    i++
  :: i == SLOTS -> break
  od
}

init {
  byte i;
  atomic {
    for (i : 0 .. SLOTS - 1) {
      slot[i] = MAKE(i % DEPTH)
    }
    for (i : 0 .. READERS - 1) {
      run reader(i)
    }
    for (i : 0 .. PUSHERS - 1) {
      run pusher(i)
    }
#ifndef NO_ROUSER
    run rouser();
#endif
#ifdef MORTAL_PUBLISHER
    run reaper();
#endif
#if MORTAL_READERS || defined(MORTAL_PUBLISHER)
    run kernel_fate();
#endif
    i = 0
  }
}

/* Under weak fairness: a process that can move all the time does so in the end. */
#ifdef QUIET
ltl quiet { <> (ended[0] && ended[READERS - 1]) }
#endif
