// SPDX-License-Identifier: Apache-2.0
/* An ear: one sleeper that listens to many rings, and sleeps on one word (docs/ear.md).
 *
 * Publishers push into rings of one slot, close them, are killed after any step, or stand still. An announcer tells
 * of a new ring. A plain reader may sleep on the slot of ring 0, and leave the mark that the ear depends on. The ear
 * looks at the rings that have news, and at nothing else: the look at everything once a second is left out, so that
 * each lost wake-up is an invalid end state.
 *
 * Everything is sequentially consistent here: memory orders are the business of tests/proof/model.
 *
 * run two -DMESSAGES=2 : two rings, two messages each
 * run one_by_one -DMESSAGES=2 -DREADS_ONE : a handler reads one message, and the set is run again
 * run beside -DBESIDE -DRINGS=1 -DMESSAGES=2 : a reader sleeps on the same slot
 * run close -DCLOSES : publishers send and go
 * run announce -DANNOUNCES -DRINGS=1 -DMESSAGES=2 : a new version of the directory, while messages come
 * run killed -DMORTAL_PUBLISHER : a publisher is killed after any step
 * run killed_beside -DMORTAL_PUBLISHER -DBESIDE -DRINGS=1 : the same, with a reader on its slot
 * run announcer_killed -DANNOUNCES -DMORTAL_ANNOUNCER -DRINGS=1 : the announcer is killed after any step
 * run stands -DSTANDS -DMESSAGES=2 : a publisher stands still behind any step: the other one is heard all the same
 * run stale -DSTALE -DRINGS=1 -DMESSAGES=2 : the former owner's bits are there, and it is rung for nothing
 * full three -DRINGS=3 : three rings
 * full closed_beside -DCLOSES -DBESIDE -DMESSAGES=2 : two readers, two rings that end
 *
 * pan -DCOLLAPSE
 *
 * plant MARK_BEFORE_BIT two : it leaves its mark, and then says that it listens
 * plant COUNT_AFTER_NEWS two : it takes the news, and then notes the count of the bell
 * plant BELL_BEFORE_NEWS two : the bell is rung, and then it is said why
 * plant SLEEPS_ON_PRESENT_BELL two : it sleeps on the bell as it is, and not as it was before the news
 * plant NEWS_IN_TWO_STEPS two : it looks at the news, and then stores that there are none
 * plant NEVER_SAYS_THAT_IT_SLEEPS two : no waker knows that it sleeps
 * plant NOT_DUE_AFTER_THE_HANDLER one_by_one : what had a message is looked at no more
 * plant ONLY_MY_MARK beside : a reader that finds a mark takes it for no business of the ears
 * plant NO_RECHECK_ORPHAN close : the writer word is not looked at after the mark
 * plant CLOSE_RINGS_FIRST close : a closing publisher rings before it says that it has gone
 * plant ANNOUNCER_WAKES_SLOTS_ONLY announce : a waker that takes a mark away without a message rings no ears
 * plant NO_DIRECTORY_RECHECK announce : the directory is not looked at after the mark
 * plant REAPER_TRUSTS_MARKS killed : the reaper rings only where it finds a mark
 * plant REAPER_WAKES_SLOTS_ONLY killed : the reaper rings no ears
 * plant ANNOUNCER_IS_FORGOTTEN announcer_killed : the reaper does not ring in the place of a dead announcer
 * plant WAKER_TAKES_ASLEEP_AWAY stands : one waker wakes it, and the others rely on that
 */

#ifndef RINGS
#define RINGS 2
#endif
#ifndef MESSAGES
#define MESSAGES 1
#endif

/* A slot: the sequence, the round and the sleeper's mark. The first sequence is 1. */
#define MARK 1
#define ROUND 2
#define SEQUENCE(w) ((w) >> 2)
#define MAKE(sequence) ((sequence) << 2)
#define CLEARED(w) ((w) & MARK -> (w) & ~(MARK | ROUND) | (w) + ROUND & ROUND : (w))
#define FIRST 1
/* The bell: how often it was rung, and whether the ear sleeps. */
#define ASLEEP 1
#define ONE 2

/* shared */
byte slot[RINGS];
bit orphan[RINGS];
byte directory;
bit listener[RINGS];
bit news[RINGS];
byte bell;

/* kernel */
bit ear_sleeps;    /* on the bell */
bit reader_sleeps; /* on slot 0 */

/* ghost */
byte published[RINGS];
byte done;  /* a bit for each publisher that has ended, was reaped, or stands still */
bit told;   /* the announcer has ended, or there is none */
bit dead, announcer_dead;
bit reaped; /* or no process may die */
bit stands; /* publisher 0 */

inline kernel_wake_ear() { ear_sleeps = 0 }
inline kernel_wake_slot(c) { if :: (c) == 0 -> reader_sleeps = 0 :: else fi }

#ifdef STANDS
#define MAY_STAND(c) if :: (c) == 0 -> atomic { stands = 1; done = done | 1 }; goto end_stands :: true fi
#else
#define MAY_STAND(c) skip
#endif

/* The steps of the process that has changed the slot of a ring: they tell the ear, if it listens. */
inline ring_ears(c, b) {
  if
  :: listener[c] -> /* @ src/lockfree_ring/ear.hpp each: Word left = words_[w].load(std::memory_order_seq_cst) */
    MAY_STAND(c);
#ifndef BELL_BEFORE_NEWS
    news[c] = 1; /* @ src/lockfree_ring/ear.hpp tell: news[channel / 64].fetch_or(Word{1} << channel % 64 */
    MAY_STAND(c);
#endif
    atomic {
      b = bell; /* @ src/lockfree_ring/ear.hpp ring: this->fetch_add(kOne, std::memory_order_release) */
#ifdef WAKER_TAKES_ASLEEP_AWAY
      bell = (bell & ~ASLEEP) + ONE
#else
      bell = bell + ONE /* @ src/lockfree_ring/ear.hpp ring: this->fetch_add(kOne, std::memory_order_release) */
#endif
    };
    MAY_STAND(c);
#ifdef BELL_BEFORE_NEWS
    news[c] = 1;
#endif
    if
    :: b & ASLEEP -> kernel_wake_ear() /* @ src/segment/segment.cpp ring_ears: if (is_asleep) futex::wake_all(bell) */
    :: else
    fi;
    b = 0
  :: !listener[c] /* @ src/lockfree_ring/ear.hpp each: Word left = words_[w].load(std::memory_order_seq_cst) */
  fi
}

/* ---- publishers -------------------------------------------------------------------------------- */

proctype publisher(byte c) {
  byte next, old, b;
  {
    next = FIRST;
    do
    :: next < FIRST + MESSAGES ->
      atomic {
        old = slot[c]; /* @ src/lockfree_ring/ring.hpp publish: const Word old = slot.exchange(make(next_, block) */
        slot[c] = MAKE(next); /* @ src/lockfree_ring/ring.hpp publish: const Word old = slot.exchange(make(next_, block) */
        published[c]++
      };
      if
      :: old & MARK ->
        MAY_STAND(c);
        ring_ears(c, b); /* @ src/transport/pusher.cpp wake_readers: participant_->segment().ring_ears(name_.channel */
        kernel_wake_slot(c) /* @ src/transport/pusher.cpp wake_readers: futex::wake(word, futex::kWakes) */
      :: else
      fi;
      atomic { old = 0; next++ }
    :: else -> break
    od;
#ifdef CLOSES
#ifdef CLOSE_RINGS_FIRST
    slot[c] = CLEARED(slot[c]);
    ring_ears(c, b);
    kernel_wake_slot(c);
    orphan[c] = 1;
#else
    orphan[c] = 1; /* @ src/recovery/recovery.hpp orphan_ring: writer.end(generation, k) */
    slot[c] = CLEARED(slot[c]); /* @ src/recovery/recovery.hpp wake_readers: r.clear_sleepers() */
    kernel_wake_slot(c); /* @ src/recovery/recovery.hpp wake_readers: r.wake_sleepers */
    ring_ears(c, b); /* @ src/recovery/recovery.hpp wake_readers: world_.ring_ears(r.channel) */
#endif
#endif
    atomic { next = 0; done = done | 1 << c; goto over };
end_stands:
    false;
over:
    skip
  } unless { d_step { c == 0 && dead -> next = 0; old = 0; b = 0 } }
}

#ifdef ANNOUNCES
/* Tells of a new ring: its own one is not here. */
proctype announcer() {
  byte b, c;
  {
    directory = 1; /* @ src/lockfree_ring/sleep.hpp announce: directory.bump() */
    do
    :: c < RINGS ->
      slot[c] = CLEARED(slot[c]); /* @ src/lockfree_ring/sleep.hpp wake_sleepers: if (clear_sleeper(ring.slots[i])) wake(ring.slots[i]) */
      kernel_wake_slot(c); /* @ src/lockfree_ring/sleep.hpp wake_sleepers: if (clear_sleeper(ring.slots[i])) wake(ring.slots[i]) */
#ifndef ANNOUNCER_WAKES_SLOTS_ONLY
      ring_ears(c, b); /* @ src/lockfree_ring/sleep.hpp wake_sleepers: ring_ears(ring.channel) */
#endif
      c++
    :: else -> break
    od;
    told = 1
  } unless { d_step { announcer_dead -> b = 0; c = 0 } }
}
#endif

/* ---- the ear ----------------------------------------------------------------------------------- */

#define READ(c) (cursor[c] == FIRST + published[c] || (c == 0 && stands))
#if RINGS == 1
#define ALL_READ READ(0)
#elif RINGS == 2
#define ALL_READ (READ(0) && READ(1))
#else
#define ALL_READ (READ(0) && READ(1) && READ(2))
#endif
/* Sleeping for ever is right only when all is read, and nothing can come any more. */
#define NOTHING_CAN_COME (ALL_READ && version == directory && told && reaped && done == (1 << RINGS) - 1 && ends_seen)
#if defined(CLOSES)
#define ends_seen (finished == RINGS)
#elif defined(MORTAL_PUBLISHER)
#define ends_seen (!dead || ended[0])
#else
#define ends_seen true
#endif

proctype ear() {
  byte cursor[RINGS], w, c, rung, version, finished;
  bit due[RINGS], ended[RINGS], any;
  atomic {
    for (c : 0 .. RINGS - 1) { cursor[c] = FIRST; due[c] = 1 }
    c = 0
  };
take:
  any = 0;
  bell = bell & ~ASLEEP; /* @ src/waiting/hearing.hpp take: if (std::exchange(sleeps_, false)) shared_.words->bell.wake_up() */
#ifndef COUNT_AFTER_NEWS
  rung = bell & ~ASLEEP; /* @ src/waiting/hearing.hpp take: rung_ = shared_.words->bell.rung() */
#endif
#ifdef NEWS_IN_TWO_STEPS
  atomic { for (c : 0 .. RINGS - 1) { due[c] = due[c] | news[c] } };
  atomic { for (c : 0 .. RINGS - 1) { news[c] = 0 } };
  c = RINGS;
#else
  do
  :: atomic { c < RINGS && news[c] -> news[c] = 0; due[c] = 1; c++ } /* @ src/lockfree_ring/ear.hpp take: Word left = news[w].exchange(0, std::memory_order_acquire) */
  :: atomic { c < RINGS && !news[c] -> c++ } /* @ src/lockfree_ring/ear.hpp take: if (news[w].load(std::memory_order_relaxed) == 0) continue */
  :: c == RINGS -> break
  od;
#endif
#ifdef COUNT_AFTER_NEWS
  rung = bell & ~ASLEEP;
#endif
  c = 0;
  do
  :: c < RINGS && (!due[c] || ended[c]) -> c++
  :: c < RINGS && due[c] && !ended[c] ->
    version = directory; /* @ src/transport/puller.cpp arm: if (directory_.load(std::memory_order_acquire) != version_) find_new_rings() */
    atomic {
      w = slot[c]; /* @ src/transport/puller.cpp arm: if (has_messages()) */
      if
      :: SEQUENCE(w) >= cursor[c] ->
#ifdef READS_ONE
        cursor[c] = cursor[c] + 1;
#else
        cursor[c] = SEQUENCE(w) + 1;
#endif
        any = 1;
#ifdef NOT_DUE_AFTER_THE_HANDLER
        due[c] = 0;
#endif
        goto next
      :: else
      fi
    };
    atomic {
      if
      :: orphan[c] -> /* @ src/lockfree_ring/sleep.hpp settle: if (!s->reader.ended() || s->reader.has_returns()) return false */
        if
        :: SEQUENCE(slot[c]) < cursor[c] -> ended[c] = 1; finished++; due[c] = 0 /* @ src/lockfree_ring/sleep.hpp settle: if (!s->reader.ended() || s->reader.has_returns()) return false */
        :: else
        fi;
        any = 1;
        goto next
      :: !orphan[c] /* @ src/lockfree_ring/sleep.hpp settle: if (!s->reader.orphaned()) */
      fi
    };
#ifndef MARK_BEFORE_BIT
    listener[c] = 1; /* @ src/transport/puller.cpp arm_by: hearer.listen(s.name.channel) */
#endif
    atomic {
      w = slot[c]; /* @ src/lockfree_ring/ring.hpp mark_sleeping: Word seen = slot.load */
      if
      :: SEQUENCE(w) >= cursor[c] -> any = 1; goto next
      :: else
      fi
    };
    atomic {
      if
      :: w & MARK
#ifdef ONLY_MY_MARK
        -> listener[c] = 0
#endif
      :: !(w & MARK) && slot[c] == w -> slot[c] = w | MARK /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
      :: !(w & MARK) && slot[c] != w -> any = 1; goto next /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
      fi
    };
#ifdef MARK_BEFORE_BIT
    listener[c] = 1;
#endif
#ifndef NO_RECHECK_ORPHAN
    if
    :: orphan[c] -> any = 1; goto next /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
    :: !orphan[c] /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
    fi;
#endif
#ifndef NO_DIRECTORY_RECHECK
    if
    :: directory != version -> any = 1; goto next /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: const std::uint32_t now = directory.load(std::memory_order_relaxed) */
    :: directory == version /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: const std::uint32_t now = directory.load(std::memory_order_relaxed) */
    fi;
#endif
    due[c] = 0;
next:
    atomic { w = 0; c++ }
  :: c == RINGS -> break
  od;
  c = 0;
  if
  :: any -> goto take
  :: else
  fi;
#ifndef NEVER_SAYS_THAT_IT_SLEEPS
  bell = bell | ASLEEP; /* @ src/lockfree_ring/ear.hpp sleep: this->fetch_or(kAsleep, std::memory_order_relaxed) */
#endif
#ifdef SLEEPS_ON_PRESENT_BELL
  rung = bell & ~ASLEEP;
#endif
  atomic {
    if
#ifdef NEVER_SAYS_THAT_IT_SLEEPS
    :: bell == rung -> ear_sleeps = 1
#else
    :: bell == (rung | ASLEEP) -> ear_sleeps = 1 /* @ src/waiting/hearing.cpp prepare_to_sleep: shared_.words->bell.sleep(rung_) */
#endif
    :: else -> goto take
    fi
  };
  if
  :: !ear_sleeps -> goto take
  :: ear_sleeps && NOTHING_CAN_COME
  fi
}

/* ---- a reader that sleeps on slot 0 ------------------------------------------------------------ */

proctype reader() {
  byte cursor = FIRST, w;
  do
  :: atomic {
      w = slot[0]; /* @ src/lockfree_ring/ring.hpp mark_sleeping: Word seen = slot.load */
      if
      :: SEQUENCE(w) >= cursor -> cursor = SEQUENCE(w) + 1; w = 0
      :: SEQUENCE(w) < cursor && orphan[0] -> break /* @ src/lockfree_ring/ring.hpp ended: orphaned() && */
      :: SEQUENCE(w) < cursor && !orphan[0] /* @ src/lockfree_ring/ring.hpp ended: orphaned() && */
      fi
    };
    if
    :: w == 0
    :: else ->
      atomic {
        if
        :: slot[0] == w -> w = w | MARK; slot[0] = w /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
        :: else -> w = 0
        fi
      };
      if
      :: w == 0 || orphan[0] /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
      :: w != 0 && !orphan[0] -> /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
        atomic { reader_sleeps = (slot[0] == w) }; /* kernel: a slot that has changed is not slept on */
end_sleeps:
        !reader_sleeps
      fi;
      w = 0
    fi
  od
}

/* ---- fate -------------------------------------------------------------------------------------- */

proctype kernel_fate() {
  atomic {
    if
#ifdef MORTAL_PUBLISHER
    :: dead = 1
#endif
#ifdef MORTAL_ANNOUNCER
    :: !told -> announcer_dead = 1
#endif
    :: reaped = 1
    fi
  }
}

/* A reaper does not ask: neither marks nor bells. */
inline reap_ring(c) {
  atomic {
    marked = slot[c] & MARK; /* @ src/lockfree_ring/ring.hpp clear_sleepers: clear_sleeper(slots[i]) */
    slot[c] = CLEARED(slot[c]) /* @ src/lockfree_ring/ring.hpp clear_sleepers: clear_sleeper(slots[i]) */
  };
  kernel_wake_slot(c); /* @ src/recovery/recovery.hpp wake_readers: r.wake_sleepers([this](auto& word) { world_.wake(word); }) */
#ifndef REAPER_WAKES_SLOTS_ONLY
  if
#ifdef REAPER_TRUSTS_MARKS
  :: !marked
#endif
  :: !listener[c] /* @ src/recovery/recovery.hpp wake_readers: world_.ring_ears(r.channel) */
#ifdef REAPER_TRUSTS_MARKS
  :: marked && listener[c] ->
#else
  :: listener[c] -> /* @ src/transport/world.hpp ring_ears: segment_.ring_ears(c, [](const void* bell, bool) */
#endif
    news[c] = 1; /* @ src/lockfree_ring/ear.hpp tell: news[channel / 64].fetch_or(Word{1} << channel % 64 */
    bell = bell + ONE; /* @ src/lockfree_ring/ear.hpp ring: this->fetch_add(kOne, std::memory_order_release) */
    kernel_wake_ear() /* @ src/transport/world.hpp ring_ears: futex::wake_all(bell) */
  fi
#endif
}

proctype reaper() {
  bit marked;
  byte c;
end_idle:
  if
  :: dead ->
    orphan[0] = 1; /* @ src/recovery/recovery.hpp orphan_ring: writer.end(generation, k) */
    reap_ring(0);
    atomic { reaped = 1; done = done | 1 }
  :: announcer_dead ->
    directory = 2; /* @ src/recovery/recovery.hpp wake_whom_it_announced_to: world_.renew_directory() */
#ifndef ANNOUNCER_IS_FORGOTTEN
    do
    :: c < RINGS -> reap_ring(c); c++ /* @ src/recovery/recovery.hpp wake_whom_it_announced_to: wake_readers(r) */
    :: else -> break
    od;
#endif
    atomic { told = 1; reaped = 1 }
  fi
}

init {
  byte i;
  atomic {
#ifdef STALE
    listener[0] = 1;
    news[0] = 1;
    bell = ASLEEP;
#endif
    run ear();
    for (i : 0 .. RINGS - 1) {
      run publisher(i)
    }
#ifdef BESIDE
    run reader();
#endif
#ifdef ANNOUNCES
    run announcer();
#else
    told = 1;
#endif
#if defined(MORTAL_PUBLISHER) || defined(MORTAL_ANNOUNCER)
    run reaper();
    run kernel_fate();
#else
    reaped = 1;
#endif
    i = 0
  }
}
