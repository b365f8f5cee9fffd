// SPDX-License-Identifier: Apache-2.0
/* Sleep and wake: nobody sleeps while there is something to do, whoever is killed.
 *
 * Readers sleep on the slots of all their rings at once, or on the directory when they have none. A
 * second publisher appears while they sleep. Under back-pressure (ROOM) a sender sleeps for room.
 * Publishers, readers and wardens are killed after any step. A lost wake is an invalid end state:
 * somebody sleeps and nobody is left who could move.
 *
 * Everything is sequentially consistent here: memory orders are the business of tests/proof/model. Who may
 * reap whom is the business of join_leave_reap.pml: a warden that finds a dead participant's byte
 * free takes it. A push wakes two, which are all here: how the rest wakes is the business of
 * many_sleepers.pml.
 *
 * run stream -DMESSAGES=3 -DDEPTH=2 : two readers, three messages in two slots
 * run close -DCLOSES : two readers, a message, and the publisher goes
 * run killed -DMORTALS=2 : the same, and it is killed
 * run reapers -DREADERS=1 -DTWO_WARDENS -DMORTALS=34 : the publisher dies, and so does who repairs that
 * run two_rings -DRINGS=2 -DREADERS=1 -DMORTALS=4 : a second publisher appears, or is killed on its way
 * run succession -DRINGS=2 -DREADERS=1 -DMORTALS=2 : the first publisher may be gone when the second one comes
 * run room -DROOM -DREADERS=1 -DMESSAGES=2 -DTIMED_LOOK -DMORTALS=8 : a sender waits for a reader that leaves or dies
 * run room_by_wakes -DROOM -DREADERS=1 -DMESSAGES=2 -DMORTALS=8 : the same without the timed look; nobody dies in leave()
 * run served -DCLOSES -DSERVED : everybody who waits is served in the end
 * run served_killed -DREADERS=1 -DMORTALS=2 -DSERVED : and learns of the publisher's death
 * run sent -DROOM -DREADERS=1 -DMESSAGES=2 -DTIMED_LOOK -DNO_WARDEN -DMORTALS=8 -DSENT : the sender alone notices a dead laggard
 * full killed_reader -DMORTALS=18 : a reader dies as well, and its mark stays
 * full killed_deep -DMORTALS=2 -DDEPTH=2 -DMESSAGES=2 -DCLOSES : more slots and messages, and the end
 * full room_for_two -DROOM -DTIMED_LOOK -DMORTALS=16 : a sender waits for two readers
 * run two_rings_two_readers -DRINGS=2 : two readers meet the second publisher, one later than the other
 *
 * pan -DNFAIR=3 -DCOLLAPSE
 *
 * plant CONDITIONAL_WAKE killed : the reaper wakes only where it finds a mark
 * plant CLOSE_WAKES_FIRST close : a closing publisher wakes before it says that it has gone
 * plant NO_RECHECK_ORPHAN close : the writer word is not looked at after the mark
 * plant MARK_IS_A_SEPARATE_WORD stream : sleepers are announced beside the slot
 * plant EXCHANGE_IN_TWO_STEPS stream : the publisher looks at the mark, then stores
 * plant MARK_WITHOUT_COMPARE stream : the mark is set whatever has come into the slot
 * plant RELEASE_NAME_FIRST reapers : the dead one's name goes before its sleepers are woken
 * plant NO_DIRECTORY_RECHECK two_rings : the directory is not looked at after the mark
 * plant ANNOUNCE_WAKES_DIRECTORY_ONLY two_rings : who sleeps on another ring does not learn of a new one
 * plant SAME_ROUND two_rings_two_readers : a reader sleeps on a mark that another one has set again, and misses the new ring
 * plant DIRECTORY_IS_NOT_WOKEN succession : who has no ring does not learn of a new one
 * plant NO_DOZE two_rings : who cannot look for the new ring at once sleeps as if there were none
 * plant ANNOUNCER_IS_FORGOTTEN two_rings : nobody wakes whose mark a dead announcer took
 * plant NO_ROOM_RECHECK room_by_wakes : the sender does not look again once its mark stands
 * plant BELL_KEEPS_MARK room_by_wakes : the bell wakes, and leaves the word as it was
 * plant REAPER_KEEPS_SPACE room_by_wakes : the reaper wakes the sender and leaves the word as it was
 * plant NO_LOOK_AT_SPACE room_by_wakes : a reader that made room does not look whether the sender waits
 * plant LEAVER_MAY_DIE room_by_wakes : why the timed look is needed: who[] is cleared before the wake
 * plant NO_PROBE sent : a sender that waits does not ask whether the laggard lives
 */

#ifndef RINGS
#define RINGS 1
#endif
#ifndef READERS
#define READERS 2
#endif
#ifndef DEPTH
#define DEPTH 1
#endif
#ifndef MESSAGES
#define MESSAGES 1
#endif
#ifndef MORTALS
#define MORTALS 0 /* who may be killed, a bit each */
#endif

/* Who there is. Publishers and readers are participants of these numbers; ring c is publisher c's. */
#define PUBLISHER(c) (1 + (c))
#define READER(r) (3 + (r))
#define LAGGARD READER(READERS - 1)
#define PARTICIPANTS 5
#define WARDEN 5
#define SECOND_WARDEN 6
#define PROCESSES 7

/* A slot: the sequence, the round and the sleeper's mark. Sequences begin with DEPTH. */
#define MARK 1
#define ROUND 2
#define ROUNDS 6
#define SEQUENCE(w) ((w) >> 3)
#define MAKE(sequence) ((sequence) << 3)
#ifdef SAME_ROUND
#define CLEARED(w) ((w) & ~MARK)
#else
#define CLEARED(w) ((w) & MARK -> (w) & ~(MARK | ROUNDS) | (w) + ROUND & ROUNDS : (w))
#endif
#define SLOT(c, s) ((c) * DEPTH + (s) % DEPTH)
/* Sequence of the first message that is published: with ROOM the ring is full from the start. */
#ifdef ROOM
#define FIRST (2 * DEPTH)
#else
#define FIRST DEPTH
#endif
/* The writer word. */
#define FREE 0
#define INIT 1
#define LIVE 2
#define ORPHAN 3
#define WRITER(state, owner) ((owner) << 2 | (state))
#define STATE(w) ((w) & 3)
#define OWNER(w) ((w) >> 2)
/* The space word counts; between the sender's mark and its wait it moves by 5 at most. */
#define SPACE_VALUES 8
/* A position that is no cursor. */
#define IDLE 255
/* Futexes: the slots, the directory, the space word. */
#define DIRECTORY (RINGS * DEPTH)
#define SPACE (DIRECTORY + 1)

/* shared */
byte slot[RINGS * DEPTH];
byte writer[RINGS];
byte who[RINGS * READERS];
byte directory;
byte registry;           /* robust lock: its owner */
byte lock[PARTICIPANTS]; /* kernel locks on the bytes of the lock file: their owners */
bit part[PARTICIPANTS];
#ifdef ROOM
byte space;
byte position[READERS];
#endif
#ifdef MARK_IS_A_SEPARATE_WORD
bit sleepers[RINGS * DEPTH];
#endif

/* kernel */
byte queued[PROCESSES]; /* the futexes that a process is queued on, a bit each */
bit woken[PROCESSES];

/* ghost */
bit dead[PROCESSES];
bit ended[PROCESSES];
bit protected[PROCESSES]; /* is not killed at this moment */
byte published[RINGS];

inline kernel_wake(futex) {
  d_step {
    for (q : 1 .. PROCESSES - 1) {
      if
      :: (queued[q] >> (futex)) & 1 -> queued[q] = 0; woken[q] = 1
      :: else
      fi
    }
    q = 0
  }
}

/* One word of FUTEX_WAIT or futex_waitv: compares and queues in one step. */
inline kernel_queue(p, futex, word, value, otherwise) {
  if
  :: (word) == (value) -> queued[p] = queued[p] | 1 << (futex)
  :: else -> queued[p] = 0; woken[p] = 0; goto otherwise
  fi
}

inline kernel_dies(p) {
  d_step {
    dead[p] = 1;
    queued[p] = 0;
    woken[p] = 0;
    for (q : 0 .. PARTICIPANTS - 1) {
      if
      :: lock[q] == p -> lock[q] = 0
      :: else
      fi
    }
    if
    :: registry == p -> registry = 0
    :: else
    fi;
    q = 0
  }
}

inline acquire(word, p) { atomic { (word) == 0 -> word = p } }

/* ---- what repairs ------------------------------------------------------------------------------ */

inline clear_sleepers(c) {
  do
  :: atomic { i < DEPTH ->
#ifdef CONDITIONAL_WAKE
      if
      :: slot[SLOT(c, i)] & MARK -> marked = 1
      :: else
      fi;
#endif
      slot[SLOT(c, i)] = CLEARED(slot[SLOT(c, i)]); /* @ src/lockfree_ring/ring.hpp clear_sleepers: clear_sleeper(slots[i]) */
      i++ }
  :: atomic { i == DEPTH -> i = 0; break }
  od
}

inline wake_slots(c) {
  do
  :: atomic { i < DEPTH ->
#ifdef CONDITIONAL_WAKE
      if
      :: marked -> kernel_wake(SLOT(c, i))
      :: else
      fi;
#else
      kernel_wake(SLOT(c, i)); /* @ src/recovery/recovery.hpp wake_readers: r.wake_sleepers([this](auto& word) { world_.wake(word); }) */
#endif
      i++ }
  :: atomic { i == DEPTH -> i = 0; marked = 0; break }
  od
}

inline wake_readers(c) {
  clear_sleepers(c); /* @ src/recovery/recovery.hpp wake_readers: r.clear_sleepers() */
  wake_slots(c)
}

/* Whoever announces a ring takes marks away in the others, and wakes: all of it, if k began to. That the
 * reaper takes the marks away first is left out, it makes the runs with two rings much larger: tests/proof/model
 * has it (announced_by_the_reaper). */
inline wake_whom_it_announced_to(k) {
#if RINGS > 1
#ifdef ANNOUNCER_IS_FORGOTTEN
  skip
#else
  if
  :: k < READER(0) && OWNER(writer[c]) == k && STATE(writer[c]) > INIT -> /* @ src/recovery/recovery.hpp wake_whom_it_announced_to: published = ring::writer_owner(w) == k && ring::writer_state(w) > ring::State::Init */
    directory++; /* @ src/transport/world.cpp renew_directory: version.bump() */
    kernel_wake(DIRECTORY); /* @ src/transport/world.cpp renew_directory: futex::wake_all(&version.word()) */
    if
    :: STATE(writer[0]) == LIVE -> wake_slots(0) /* @ src/recovery/recovery.hpp wake_whom_it_announced_to: if (ring::writer_state(w) != ring::State::Live) continue */
    :: else
    fi;
    if
    :: STATE(writer[1]) == LIVE -> wake_slots(1) /* @ src/recovery/recovery.hpp wake_whom_it_announced_to: if (ring::writer_state(w) != ring::State::Live) continue */
    :: else
    fi
  :: else
  fi
#endif
#else
  skip
#endif
}

inline orphan_ring(c, k) {
  atomic {
    w = writer[c]; /* @ src/recovery/recovery.hpp orphan_ring: const ring::Word w = writer.load */
    if
    :: OWNER(w) != k || STATE(w) == FREE -> w = 0; goto kept
    :: else
    fi
  };
  if
  :: STATE(w) == INIT ->
    atomic {
      writer[c] = WRITER(FREE, 0); /* @ src/recovery/recovery.hpp orphan_ring: writer.free(generation + 1) */
      w = 0;
      goto kept
    }
  :: else
  fi;
#ifdef RELEASE_NAME_FIRST
  writer[c] = WRITER(ORPHAN, 0);
#else
  writer[c] = WRITER(ORPHAN, k); /* @ src/recovery/recovery.hpp orphan_ring: writer.end(generation, k) */
#endif
  wake_readers(c); /* @ src/recovery/recovery.hpp orphan_ring: wake_readers(r) */
  atomic {
    writer[c] = WRITER(ORPHAN, 0); /* @ src/recovery/recovery.hpp orphan_ring: writer.give_to_orphanage(generation, refcount::kOrphanage) */
    w = 0
  };
kept:
  skip
}

inline free_cell(c, r, k) {
  if
  :: who[c * READERS + r] == k -> /* @ src/recovery/recovery.hpp free_cells: if (r.who[i].load */
#ifdef ROOM
    position[r] = IDLE; /* @ src/recovery/recovery.hpp make_idle: word.compare_exchange_strong(position, ring::kIdle */
#ifndef REAPER_KEEPS_SPACE
    space = (space + 2) % SPACE_VALUES; /* @ src/recovery/recovery.hpp free_cells: r.space->fetch_add(2 */
#endif
    kernel_wake(SPACE); /* @ src/recovery/recovery.hpp free_cells: world_.wake(*r.space) */
#endif
    who[c * READERS + r] = 0 /* @ src/recovery/recovery.hpp free_cells: r.who[i].compare_exchange_strong(dead, 0 */
  :: else
  fi
}

inline reap(k) {
  if
  :: atomic { k < READER(0) -> c = k - PUBLISHER(0) };
    wake_whom_it_announced_to(k); /* @ src/recovery/recovery.hpp reap: wake_whom_it_announced_to(k) */
    orphan_ring(c, k) /* @ src/recovery/recovery.hpp reap: orphan_ring(c, k) */
  :: k >= READER(0) ->
    do
    :: c < RINGS -> free_cell(c, k - READER(0), k); c++ /* @ src/recovery/recovery.hpp reap: free_cells(c, k) */
    :: else -> break
    od
  fi;
  atomic {
    part[k] = 0; /* @ src/recovery/recovery.hpp reap: world_.participant_state(k).free() */
    c = 0
  }
}

#define IS_DEAD(k) (part[k] && lock[k] == 0)

proctype warden(byte p) {
  byte k, c, i, w, q;
  bit marked;
  {
end_idle:
    do
    :: atomic { IS_DEAD(1) -> lock[1] = p; k = 1; break } /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.try_lock(k) */
    :: atomic { IS_DEAD(2) -> lock[2] = p; k = 2; break } /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.try_lock(k) */
    :: atomic { IS_DEAD(3) -> lock[3] = p; k = 3; break } /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.try_lock(k) */
    :: atomic { IS_DEAD(4) -> lock[4] = p; k = 4; break } /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.try_lock(k) */
    od;
    acquire(lock[0], p); /* @ src/transport/reaper.cpp reap_if_dead: enter_orphanage() */
    reap(k); /* @ src/transport/reaper.cpp reap_if_dead: Recovery(world_).reap(k) */
    lock[0] = 0; /* @ src/transport/reaper.cpp reap_if_dead: leave_orphanage() */
    atomic {
      lock[k] = 0; /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.unlock(k) */
      k = 0;
      goto end_idle
    }
  } unless { d_step { dead[p] -> k = 0; c = 0; i = 0; w = 0; marked = 0 } }
}

/* ---- a publisher ------------------------------------------------------------------------------- */

inline announce() {
  directory++; /* @ src/lockfree_ring/sleep.hpp announce: directory.bump() */
#ifndef ANNOUNCE_WAKES_DIRECTORY_ONLY
  do
  :: c < RINGS && STATE(writer[c]) == LIVE -> /* @ src/registry/registry.cpp announce: return ring::writer_state(w) == ring::State::Live && detail::read_once(channels[c].topic) == topic; */
    do
    :: atomic { i < DEPTH ->
        old = slot[SLOT(c, i)]; /* @ src/lockfree_ring/ring.hpp clear_sleeper: const bool marked = (seen & kSleeper) != 0 */
        slot[SLOT(c, i)] = CLEARED(old) }; /* @ src/lockfree_ring/ring.hpp clear_sleeper: slot.compare_exchange_weak(seen, marked ? next_round(seen) : seen */
      atomic {
        if
        :: old & MARK -> kernel_wake(SLOT(c, i)) /* @ src/lockfree_ring/sleep.hpp wake_sleepers: if (clear_sleeper(ring.slots[i])) wake(ring.slots[i]) */
        :: else
        fi;
        old = 0;
        i++
      }
    :: atomic { i == DEPTH -> i = 0; c++; break }
    od
  :: atomic { c < RINGS && STATE(writer[c]) != LIVE -> c++ } /* @ src/registry/registry.cpp announce: return ring::writer_state(w) == ring::State::Live && detail::read_once(channels[c].topic) == topic; */
  :: atomic { c == RINGS -> c = 0; break }
  od;
#endif
#ifdef DIRECTORY_IS_NOT_WOKEN
  skip
#else
  kernel_wake(DIRECTORY) /* @ src/lockfree_ring/sleep.hpp announce: wake(directory.word()) */
#endif
}

inline open(me, mine) {
  acquire(registry, me); /* @ src/transport/rings.cpp open: const registry::Registry::Lock lock(registry_) */
  writer[mine] = WRITER(INIT, me); /* @ src/registry/registry.cpp open: entry.writer.claim(w, participant) */
#if RINGS > 1
  atomic {
    r = 0;
    do
    :: r < READERS -> who[mine * READERS + r] = READER(r); r++ /* @ src/lockfree_ring/ring.hpp await: who[c].store(participant + 1 */
    :: else -> r = 0; break
    od
  };
#endif
  writer[mine] = WRITER(LIVE, me); /* @ src/registry/registry.cpp open: entry.writer.go_live(generation, participant) */
  announce(); /* @ src/registry/registry.cpp open: announce(topic) */
  registry = 0 /* @ src/registry/registry.cpp ~Lock: registry_.unlock() */
}

inline publish(mine) {
#ifdef EXCHANGE_IN_TWO_STEPS
  old = slot[SLOT(mine, next)];
  atomic { slot[SLOT(mine, next)] = MAKE(next); published[mine]++ };
#else
  atomic {
    old = slot[SLOT(mine, next)]; /* @ src/lockfree_ring/ring.hpp publish: const Word old = slot.exchange(make(next_, block) */
    slot[SLOT(mine, next)] = MAKE(next); /* @ src/lockfree_ring/ring.hpp publish: const Word old = slot.exchange(make(next_, block) */
    published[mine]++
  };
#endif
#ifdef MARK_IS_A_SEPARATE_WORD
  atomic { old = sleepers[SLOT(mine, next)]; sleepers[SLOT(mine, next)] = 0 };
#endif
  atomic {
    if
    :: old & MARK -> kernel_wake(SLOT(mine, next)) /* @ src/transport/pusher.cpp publish: if (published.wake) wake_unlocked(lock, *published.slot); */
    :: else
    fi;
    old = 0;
    next++
  }
}

inline close_ring(me, mine) {
#ifdef CLOSE_WAKES_FIRST
  wake_readers(mine);
  writer[mine] = WRITER(ORPHAN, 0);
#else
  writer[mine] = WRITER(ORPHAN, me); /* @ src/transport/reaper.cpp end_ring: world_.channel_writer(name.channel).end(name.generation, index()) */
  wake_readers(mine); /* @ src/transport/reaper.cpp end_ring: Recovery(world_).wake_readers(r) */
  acquire(lock[0], me); /* @ src/transport/reaper.cpp give_up_rings: enter_orphanage() */
  orphan_ring(mine, me); /* @ src/transport/reaper.cpp give_up_rings: recovery.orphan_ring(c, index()) */
  lock[0] = 0 /* @ src/transport/reaper.cpp give_up_rings: leave_orphanage() */
#endif
}

#ifdef ROOM
/* Looks at the readers one after the other. The cached minimum is left out: it only saves looks. */
inline look_for_room() {
  do
  :: atomic { r < READERS ->
      w = position[r]; /* @ src/lockfree_ring/ring.hpp place_of: word.load */
      if
      :: w == IDLE || next - w < DEPTH -> r++
      :: else -> r = 0; crowded = 1; break
      fi;
      w = 0 }
  :: atomic { r == READERS -> r = 0; crowded = 0; break }
  od
}

inline wait_for_room(me) {
  look_for_room(); /* @ src/transport/pusher.cpp push_unique: !writer_->room() && !wait_for_room(lock, queue_guard, limit) */
  if
  :: !crowded -> goto room
  :: else
  fi;
mark:
  atomic {
    w = 0;
    space = space | 1; /* @ src/lockfree_ring/ring.hpp mark_waiting: ring_.space->compare_exchange_strong(v, v + 1 */
    value = space /* @ src/lockfree_ring/ring.hpp mark_waiting: ring_.space->compare_exchange_strong(v, v + 1 */
  };
#ifndef NO_ROOM_RECHECK
  look_for_room(); /* @ src/lockfree_ring/sleep.hpp arm_for_room: if (room()) return std::nullopt */
  if
  :: !crowded -> goto room
  :: else -> w = 0
  fi;
#endif
#ifdef TIMED_LOOK
#ifndef NO_PROBE
  if
  :: atomic { IS_DEAD(LAGGARD) -> lock[LAGGARD] = me }; /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.try_lock(k) */
    acquire(lock[0], me); /* @ src/transport/reaper.cpp reap_if_dead: enter_orphanage() */
    free_cell(0, READERS - 1, LAGGARD); /* @ src/recovery/recovery.hpp reap: free_cells(c, k) */
    part[LAGGARD] = 0; /* @ src/recovery/recovery.hpp reap: world_.participant_state(k).free() */
    lock[0] = 0; /* @ src/transport/reaper.cpp reap_if_dead: leave_orphanage() */
    lock[LAGGARD] = 0 /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.unlock(k) */
  :: !IS_DEAD(LAGGARD) /* @ src/transport/pusher.cpp before_sleep: for (const std::uint32_t k : laggards_) pusher_.participant_->reaper().reap_if_dead(k) */
  fi;
#endif
#endif
  atomic { kernel_queue(me, SPACE, space, value, mark) }; /* @ src/waiting/waiting.hpp wait: Machine::sleep(sleep->words, */
  if
  :: atomic { woken[me] -> woken[me] = 0; goto mark } /* @ src/waiting/waiting.hpp wait: Machine::sleep(sleep->words, */
#ifdef TIMED_LOOK
  :: atomic { queued[me] = 0; woken[me] = 0; goto mark } /* @ src/transport/pusher.cpp arm: futex::Clock::now() + kLookPeriod */
#endif
  fi;
room:
  atomic { value = 0; crowded = 0 }
}
#endif

proctype publisher(byte mine) {
  byte me, c, i, r, w, q, old, value, next;
  bit crowded, marked;
  {
    atomic { me = PUBLISHER(mine); next = FIRST };
    if
    :: mine == 1 ->
      open(me, mine)
    :: else
    fi;
    do
    :: next < FIRST + MESSAGES ->
#ifdef ROOM
      wait_for_room(me); /* @ src/transport/pusher.cpp push_unique: wait_for_room(lock, queue_guard, limit) */
#endif
      publish(mine) /* @ src/transport/pusher.cpp publish: writer_->publish(b) */
    :: else -> break
    od;
#ifdef CLOSES
    close_ring(me, mine); /* @ src/transport/pusher.cpp ~Pusher: participant_->rings().close(name_) */
#endif
    atomic { ended[me] = 1; next = 0 }
  } unless { d_step { dead[me] -> c = 0; i = 0; r = 0; w = 0; old = 0; value = 0; next = 0; crowded = 0; marked = 0 } }
}

/* ---- a reader ---------------------------------------------------------------------------------- */

/* Sleeping for ever is right only when all is read and nothing can come any more. */
#define OVER(c) (ended[PUBLISHER(c)] || dead[PUBLISHER(c)] && STATE(writer[c]) != LIVE && STATE(writer[c]) != INIT)
#define ALL_READ(c) (cursor[c] == 0 && (who[(c) * READERS + r] != me || !published[c]) || STATE(writer[c]) == LIVE && cursor[c] == DEPTH + published[c])
#if RINGS == 1
#define NOTHING_CAN_COME (OVER(0) && ALL_READ(0))
#else
#define NOTHING_CAN_COME (OVER(0) && ALL_READ(0) && OVER(1) && ALL_READ(1))
#endif

#if RINGS == 1
#define ALONE (cursor[0] == 0)
#else
#define ALONE (cursor[0] == 0 && cursor[1] == 0)
#endif
#define GIVE_UP(otherwise) \
  queued[me] = 0; woken[me] = 0; value[0] = 0; value[RINGS - 1] = 0; \
  w = 0; s = 0; now = 0; over = 0; found = 0; goto otherwise

/* The rings that we read are those with a cursor. */
inline next_ring(s) {
  do
  :: s < RINGS && cursor[s] == 0 -> s++
  :: else -> break
  od
}

#ifdef ROOM
inline ring_bell() {
  atomic {
    old = space; /* @ src/lockfree_ring/ring.hpp ring_bell: std::uint32_t v = space.load( */
    if
    :: old & 1
    :: else -> old = 0; goto rung
    fi
  };
#ifndef BELL_KEEPS_MARK
  atomic {
    if
    :: space == old -> space = (old + 1) % SPACE_VALUES; old = 0 /* @ src/lockfree_ring/ring.hpp ring_bell: space.compare_exchange_weak(v, v + 1 */
    :: else -> old = 0; goto rung
    fi
  };
#endif
  kernel_wake(SPACE); /* @ src/transport/puller.cpp ring_bell: if (Reader::ring_bell(space)) futex::wake_all(&space) */
rung:
  skip
}
#endif

inline leave(r, s) {
#ifdef ROOM
#ifndef TIMED_LOOK
#ifndef LEAVER_MAY_DIE
  protected[me] = 1;
#endif
#endif
  position[r] = IDLE; /* @ src/lockfree_ring/ring.hpp leave: ring_.cells[cell_].position.store(kIdle */
  space = (space + 2) % SPACE_VALUES; /* @ src/lockfree_ring/ring.hpp free_cell: space->fetch_add(2 */
#endif
  atomic {
    who[s * READERS + r] = 0; /* @ src/lockfree_ring/ring.hpp free_cell: who[c].store(0 */
    cursor[s] = 0
  }
#ifdef ROOM
  ;
  kernel_wake(SPACE) /* @ src/transport/puller.cpp leave: futex::wake_all(reader.ring().space) */
#endif
}

proctype reader(byte r) {
  byte me, s, w, q, old, now, version, value[RINGS], cursor[RINGS];
  bit over, found;
  {
    atomic { me = READER(r); cursor[0] = DEPTH };
look:
#if RINGS > 1
    atomic {
      if
      :: directory == version -> goto poll /* @ src/transport/puller.cpp look: directory_.load */
      :: else
      fi
    };
    atomic {
      if
      :: registry == 0 -> registry = me /* @ src/transport/puller.cpp find_new_rings: if (!registry.try_lock()) */
      :: else -> goto poll
      fi
    };
    old = directory; /* @ src/transport/puller.cpp find_rings: const std::uint32_t version = directory_.load */
    if
    :: STATE(writer[RINGS - 1]) >= LIVE && cursor[RINGS - 1] == 0 && who[(RINGS - 1) * READERS + r] == me -> /* @ src/lockfree_ring/ring.hpp take_awaited: ring.who[c].load */
      cursor[RINGS - 1] = DEPTH
    :: STATE(writer[RINGS - 1]) < LIVE || cursor[RINGS - 1] != 0 || who[(RINGS - 1) * READERS + r] != me /* @ src/lockfree_ring/ring.hpp take_awaited: ring.who[c].load */
    fi;
    atomic {
      registry = 0; /* @ src/transport/puller.cpp find_new_rings: registry.unlock() */
      version = old;
      old = 0
    };
#endif

poll:
    atomic { s = 0; next_ring(s) };
    do
    :: atomic { s < RINGS ->
        w = slot[SLOT(s, cursor[s])]; /* @ src/lockfree_ring/ring.hpp poll: place(slot.load */
        if
        :: SEQUENCE(w) < cursor[s] -> s++; next_ring(s)
        :: else -> cursor[s] = SEQUENCE(w) + 1; w = 0; break
        fi }
    :: atomic { s == RINGS -> s = 0; w = 0; goto settle }
    od;
    /* A message: read, done. */
#ifdef ROOM
    position[r] = cursor[s]; /* @ src/lockfree_ring/ring.hpp done: ring_.cells[cell_].position.store(make(cursor_, kNoBlock) */
#ifndef NO_LOOK_AT_SPACE
    if
    :: ring_bell() /* @ src/transport/puller.cpp end: if (source.reader.done()) ring_bell(source.reader) */
    :: true /* @ src/lockfree_ring/ring.hpp done: low_half(cursor_) - asked_ < ring_.depth / kBellsPerLap */
    fi;
#endif
    if
    :: r == READERS - 1 -> leave(r, 0); goto finished /* @ src/transport/puller.cpp leave_sources: leave(s.reader) */
    :: true
    fi;
#endif
    atomic { s = 0; goto look };

settle:
    next_ring(s);
    do
    :: s < RINGS ->
#ifdef ROOM
#ifndef NO_LOOK_AT_SPACE
      ring_bell(); /* @ src/lockfree_ring/sleep.hpp settle: if (s->reader.sender_waits()) ring_bell(s->reader) */
#endif
#else
      if
      :: STATE(writer[s]) == ORPHAN -> /* @ src/lockfree_ring/ring.hpp orphaned: writer_state(ring_.writer->load */
        atomic {
          if
          :: SEQUENCE(slot[SLOT(s, cursor[s])]) >= cursor[s] -> s = 0; goto look /* @ src/lockfree_ring/ring.hpp ended: ring_.slots[index_].load */
          :: else -> assert(cursor[s] == DEPTH + published[s])
          fi
        };
        leave(r, s) /* @ src/lockfree_ring/sleep.hpp settle: leave(s->reader) */
      :: STATE(writer[s]) != ORPHAN /* @ src/lockfree_ring/ring.hpp orphaned: writer_state(ring_.writer->load */
      fi;
#endif
      atomic { s++; next_ring(s) }
    :: atomic { s == RINGS -> s = 0; break }
    od;

    /* prepare_to_sleep() */
    next_ring(s);
    do
    :: atomic { s < RINGS ->
        w = slot[SLOT(s, cursor[s])]; /* @ src/lockfree_ring/ring.hpp mark_sleeping: Word seen = slot.load */
        if
        :: SEQUENCE(w) >= cursor[s] -> found = 1; break
        :: else
        fi };
#ifdef MARK_IS_A_SEPARATE_WORD
      sleepers[SLOT(s, cursor[s])] = 1;
#else
#ifdef MARK_WITHOUT_COMPARE
      atomic { w = slot[SLOT(s, cursor[s])] | MARK; slot[SLOT(s, cursor[s])] = w };
#else
      atomic {
        if
        :: w & MARK
        :: !(w & MARK) && slot[SLOT(s, cursor[s])] == w -> /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
          w = w | MARK;
          slot[SLOT(s, cursor[s])] = w /* @ src/lockfree_ring/ring.hpp mark_sleeping: slot.compare_exchange_strong(seen, seen | kSleeper */
        :: else -> found = 1; break
        fi
      };
#endif
#endif
      atomic { value[s] = w; w = 0; s++; next_ring(s) }
    :: atomic { s == RINGS -> break }
    od;
    atomic { w = 0; s = 0; next_ring(s) };
#ifndef ROOM
#ifndef NO_RECHECK_ORPHAN
    do
    :: atomic { s < RINGS ->
        if
        :: STATE(writer[s]) == ORPHAN -> over = 1 /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look */
        :: else
        fi;
        s++; next_ring(s) }
    :: atomic { s == RINGS -> break }
    od;
#endif
#endif
    atomic {
      s = 0;
      next_ring(s);
      now = directory; /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: const std::uint32_t now = directory.load */
#ifdef NO_DIRECTORY_RECHECK
      now = version;
#endif
      if
#ifdef ROOM
      :: found ->
#else
#ifdef NO_DOZE
      :: !over && !found && now != version && now == directory ->
        value[0] = 0; value[RINGS - 1] = 0; now = 0; s = RINGS + 1
#endif
      :: over || found || now != version -> /* Dozing is short: as good as looking again. */
#endif
        GIVE_UP(look)
      :: else -> now = 0
      fi
    };
    /* The kernel compares and queues us on one word after the other. */
    do
    :: atomic { s < RINGS ->
        w = value[s];
        value[s] = 0;
#ifdef MARK_IS_A_SEPARATE_WORD
        if
        :: sleepers[SLOT(s, cursor[s])] -> w = slot[SLOT(s, cursor[s])]
        :: else -> w = IDLE
        fi;
#endif
        if
        :: slot[SLOT(s, cursor[s])] == w -> queued[me] = queued[me] | 1 << SLOT(s, cursor[s]) /* @ src/lockfree_ring/sleep.hpp leave_mark: sleep_on(source.reader.slot(), *marked, stood) */
        :: else -> GIVE_UP(look)
        fi;
        w = 0; s++; next_ring(s) }
#ifdef NO_DOZE
    :: atomic { s > RINGS -> queued[me] = 1 << DIRECTORY; s = 0; break }
#endif
    :: atomic { s == RINGS ->
        if
        :: ALONE ->
          if
          :: directory == version -> queued[me] = queued[me] | 1 << DIRECTORY /* @ src/lockfree_ring/sleep.hpp prepare_to_sleep: if (now != version || !any_live) sleep_on(directory.word(), now, false) */
          :: else -> GIVE_UP(look)
          fi
        :: else
        fi;
        s = 0;
        break }
    od;
    if
    :: atomic { woken[me] -> woken[me] = 0; queued[me] = 0; goto look } /* @ src/waiting/waiting.hpp wait: Machine::sleep(sleep->words, */
    :: NOTHING_CAN_COME
    fi;
finished:
    ended[me] = 1
  } unless { d_step { dead[me] -> s = 0; w = 0; old = 0; now = 0; version = 0; over = 0; found = 0;
    value[0] = 0; value[RINGS - 1] = 0; cursor[0] = 0; cursor[RINGS - 1] = 0 } }
}

/* ---- fate -------------------------------------------------------------------------------------- */

#define MAY_DIE(p) (MORTALS >> (p) & 1 && !dead[p] && !ended[p] && !protected[p])
#define FATE(p) :: atomic { MAY_DIE(p) -> kernel_dies(p) }

/* Kills, or loses the wish to: a state in which only a killing could go on is stuck. */
proctype kernel_fate() {
  byte q;
  do
  FATE(1)
  FATE(2)
  FATE(3)
  FATE(4)
  FATE(5)
  :: break
  od
}

init {
  byte i, c;
  atomic {
    for (c : 0 .. RINGS - 1) {
      for (i : 0 .. DEPTH - 1) {
        slot[SLOT(c, i)] = MAKE(FIRST - DEPTH + i)
      }
      lock[PUBLISHER(c)] = PUBLISHER(c);
      part[PUBLISHER(c)] = 1
    }
    writer[0] = WRITER(LIVE, PUBLISHER(0));
    published[0] = FIRST - DEPTH;
    for (i : 0 .. READERS - 1) {
      who[i] = READER(i);
      part[READER(i)] = 1;
      lock[READER(i)] = READER(i);
#ifdef ROOM
      position[i] = DEPTH;
#endif
      run reader(i)
    }
    for (c : 0 .. RINGS - 1) {
      run publisher(c)
    }
#ifndef NO_WARDEN
    run warden(WARDEN);
#endif
#ifdef TWO_WARDENS
    run warden(SECOND_WARDEN);
#endif
#if MORTALS
    run kernel_fate();
#endif
    i = 0;
    c = 0
  }
}

/* Under weak fairness: who can move all the time does so in the end. */
#ifdef SERVED
ltl served { <> (ended[READER(0)] && ended[READER(READERS - 1)]) }
#endif
#ifdef SENT
ltl sent { <> (ended[PUBLISHER(0)] || dead[PUBLISHER(0)]) }
#endif
