// SPDX-License-Identifier: Apache-2.0
/* Joining, leaving and reaping: nothing of the living is touched, nothing of the dead is left.
 *
 * A publisher takes an index, opens the ring and publishes; a reader takes another index, joins and
 * keeps a message; a newcomer comes when the publisher has gone and opens the ring anew. Each leaves
 * cleanly, or is killed after any step. Wardens reap and collect, and one of them may be killed too.
 * The last warden looks when all have gone: whatever is left then is lost for ever.
 *
 * One channel with one cell, one block, two indexes. Sleepers are the business of sleep_wake.pml, the
 * files that of creation.pml.
 *
 * run restart -DNEWCOMER_COMES -DMORTALS=2 : the publisher is killed or leaves, and is started again
 * run reapers -DREADER_COMES -DREADER_IS_SETTLED -DTWO_WARDENS -DMORTALS=18 : the publisher and who reaps it are killed
 * run readers -DREADER_COMES -DMORTALS=4 : the reader is killed, wherever the publisher is
 * run lost_lock -DNEWCOMER_COMES -DANY_TIME -DCLOSEFROM : the publisher loses its kernel lock and lives
 * run overlap -DREADER_COMES -DREADER_IS_SETTLED -DNEWCOMER_COMES -DANY_TIME -DMORTALS=2 : others come and leave while the publisher is reaped
 * run forwarded -DFORWARDED -DNEWCOMER_COMES -DMORTALS=10 : publishers of somebody else's message leave and are killed
 * run full_table -DNEWCOMER_COMES -DMORTALS=2 -DFULL_TABLE : a newcomer finds every index taken, one by somebody dead
 * run subscribed -DSUBSCRIBED -DREADER_COMES -DANY_TIME -DMORTALS=6 : a subscriber that may die gets a cell in a ring that comes later
 * full everybody -DREADER_COMES -DNEWCOMER_COMES -DMORTALS=2 : all three, and the publisher may be killed
 * full reader_and_publisher -DREADER_COMES -DMORTALS=6 : both may be killed
 *
 * pan -DCOLLAPSE
 *
 * plant NO_WITNESS lost_lock : a free byte alone counts as death
 * plant TAKEN_WITHOUT_REAP restart : the new owner of an index does not repair what the dead one left
 * plant NO_REGISTRY_LOCK readers : the recycler does not keep joiners away
 * plant JOINER_TAKES_NO_LOCK readers : the joiner does not keep the recycler away
 * plant RECYCLED_UNDER_READERS readers : a ring is recycled while somebody has a cell
 * plant RELEASE_NAME_FIRST reapers : part is cleared before what it lets a reaper find
 * plant NAME_BEFORE_COLLECT forwarded : part is cleared before the orphanage has let go
 * plant RING_NAME_FIRST reapers : the ring forgets its owner before its messages are adopted
 * plant HOLD_FIRST reapers : the dead one's hold goes before the orphanage has one
 * plant LOOKS_ONCE full_table : a dead one's index is refused while somebody reaps
 * plant NO_SECOND_LOOK subscribed : the maker of a ring does not look whether the subscriber has died
 * plant BLIND_STORE subscribed : the reaper frees a cell that has gone to a living joiner meanwhile
 * plant NO_ORPHANAGE_LOCK overlap : two act for the orphanage at once
 */

#ifndef MORTALS
#define MORTALS 0
#endif

/* Processes. */
#define PUBLISHER 1
#define READER 2
#define NEWCOMER 3
#define MORTAL_WARDEN 4
#define WARDEN 5
#define PROCESSES 6
/* Indexes 1 and 2; 0 is the orphanage. */
#define INDEXES 3
#ifdef FULL_TABLE
#define LAST 1
#else
#define LAST 2
#endif
#define NONE 0

/* The writer word: generation, state, owner. */
#define FREE 0
#define INIT 1
#define LIVE 2
#define ORPHAN 3
#define WRITER(generation, state, owner) ((generation) << 4 | (state) << 2 | (owner))
#define GENERATION(w) ((w) >> 4)
#define STATE(w) ((w) >> 2 & 3)
#define OWNER(w) ((w) & 3)
#define HOME_FREE 0
#define HOME_ORPHANAGE 1
#define HOME(k) ((k) + 1)
/* With FORWARDED the message is one of somebody else's, who lives. */
#ifdef FORWARDED
#define NOBODYS 15
#else
#define NOBODYS HOME_FREE
#endif

/* shared */
byte gate;          /* kernel locks on bytes of the lock file, by process */
byte lock[INDEXES];
byte witness[INDEXES]; /* robust locks, by process */
byte registry;
bit part[INDEXES];
byte writer;        /* of the one channel */
bit formed;
bit memory;         /* granules that carry the ring's tag */
byte who;           /* of the one cell: 0, or index + 1 */
byte pullers;       /* the index of a process that subscribes, or 0 */
bit slot;           /* the block is in the ring */
byte home = NOBODYS; /* of the one block */
byte own;           /* its holders, a bit each */

/* ghost */
byte occupant[INDEXES]; /* the process that has this index and has not begun to leave */
bit dead[PROCESSES];
bit ended[PROCESSES];
bit inside;             /* the reader has a Reader of the ring */
bit message;            /* there is a message in the block */

inline kernel_kills(p) {
  d_step {
    dead[p] = 1;
    for (q : 1 .. INDEXES - 1) {
      if
      :: occupant[q] == p -> occupant[q] = NONE
      :: else
      fi
    }
    if
    :: p == READER -> inside = 0
    :: else
    fi;
    q = 0
  }
}

/* Then it drops what the dead one held, robust locks and files one after the other. */
inline kernel_drops_robust_locks(p) {
  d_step {
    for (q : 1 .. INDEXES - 1) {
      if
      :: witness[q] == p -> witness[q] = NONE
      :: else
      fi
    }
    if
    :: registry == p -> registry = NONE
    :: else
    fi;
    q = 0
  }
}

inline kernel_drops_files(p) {
  d_step {
    for (q : 0 .. INDEXES - 1) {
      if
      :: lock[q] == p -> lock[q] = NONE
      :: else
      fi
    }
    if
    :: gate == p -> gate = NONE
    :: else
    fi;
    q = 0
  }
}

inline acquire(word, p) { atomic { (word) == NONE -> word = p } }

/* ---- the orphanage and its helpers ------------------------------------------------------------- */

inline recycle() {
  assert(!inside);
  formed = 0; /* @ src/registry/registry.cpp recycle: entry.formed.store(0 */
  memory = 0  /* @ src/registry/registry.cpp recycle: return tag == (segment::kRingTag | channel) */
}

#ifdef RECYCLED_UNDER_READERS
#define DESERTED true
#else
#define DESERTED (!formed || who == 0)
#endif
#define IS_DESERTED_ORPHAN (STATE(writer) == ORPHAN && OWNER(writer) == 0 && DESERTED)

#define IS_NEEDED (STATE(writer) == ORPHAN && formed && slot)

inline collect() {
  if
  :: IS_DESERTED_ORPHAN -> /* @ src/recovery/recovery.hpp recycle_rings: if (!has_deserted_ring(world_.channels())) return true */
#ifndef NO_REGISTRY_LOCK
    if
    :: atomic { registry == NONE -> registry = me } /* @ src/recovery/recovery.hpp recycle_rings: if (!world_.lock_rings()) return false */
    :: else -> goto unrecycled
    fi;
#endif
    if
    :: IS_DESERTED_ORPHAN -> /* @ src/recovery/recovery.hpp recycle_rings: if (!is_deserted_orphan(c)) continue */
      recycle(); /* @ src/recovery/recovery.hpp recycle_rings: world_.recycle_ring(c) */
      writer = WRITER(GENERATION(writer) + 1, FREE, 0) /* @ src/recovery/recovery.hpp recycle_rings: ring::make_writer(ring::writer_generation(w) + 1, ring::State::Free, 0) */
    :: else
    fi;
#ifndef NO_REGISTRY_LOCK
    registry = NONE /* @ src/recovery/recovery.hpp recycle_rings: world_.unlock_rings() */
#endif
  :: else
  fi;
unrecycled:
  if
  :: IS_NEEDED -> needed = 1 /* @ src/recovery/recovery.hpp mark_needed: need(ring::block(r.slots[i].load */
  :: else
  fi;
  if
  :: own & 1 && !needed -> /* @ src/recovery/recovery.hpp collect: if ((words.own[0].load */
    own = own & ~1 /* @ src/recovery/recovery.hpp collect: words.own[0].fetch_and(~std::uint64_t{1} */
  :: else
  fi;
  atomic {
    needed = 0;
    if
    :: home == HOME_ORPHANAGE && own == 0 -> /* @ src/recovery/recovery.hpp bury: !Own::die_in_orphanage(words) */
      message = 0;
      dies = 1
    :: else
    fi
  };
  if
  :: dies ->
    atomic {
      home = HOME_FREE; /* @ src/recovery/recovery.hpp bury: world_.block(b).home.store(refcount::kHomeFree */
      dies = 0
    }
  :: else
  fi
}

inline orphan_ring(k) {
  atomic {
    w = writer; /* @ src/recovery/recovery.hpp orphan_ring: const ring::Word w = writer.load */
    if
    :: OWNER(w) != k || STATE(w) == FREE -> w = 0; goto kept
    :: else
    fi
  };
  if
  :: STATE(w) == INIT ->
    recycle(); /* @ src/recovery/recovery.hpp orphan_ring: world_.recycle_ring(c) */
    writer = WRITER(GENERATION(w) + 1, FREE, 0) /* @ src/recovery/recovery.hpp orphan_ring: writer.store(ring::make_writer(generation + 1, ring::State::Free, 0) */
  :: else ->
#ifdef RING_NAME_FIRST
    writer = WRITER(GENERATION(w), ORPHAN, 0);
#else
    writer = WRITER(GENERATION(w), ORPHAN, k); /* @ src/recovery/recovery.hpp orphan_ring: writer.store(ring::make_writer(generation, ring::State::Orphan, k) */
#endif
#ifndef HOLD_FIRST
    if
    :: slot -> own = own | 1 /* @ src/refcount/ownership.hpp adopt: b.own[0].fetch_or(1 */
    :: !slot /* @ src/recovery/recovery.hpp orphan_ring: adopt(ring::block(r.slots[i].load */
    fi;
#endif
    writer = WRITER(GENERATION(w), ORPHAN, 0) /* @ src/recovery/recovery.hpp orphan_ring: writer.store(ring::make_writer(generation, ring::State::Orphan, refcount::kOrphanage) */
  fi;
  w = 0;
kept:
  skip
}

inline reap(k) {
  assert(occupant[k] == NONE);
#ifdef RELEASE_NAME_FIRST
  part[k] = 0;
#endif
  orphan_ring(k); /* @ src/recovery/recovery.hpp reap: orphan_ring(c, k) */
#ifdef SUBSCRIBED
  if
  :: pullers == k -> pullers = 0 /* @ src/registry/registry.cpp unsubscribe: pullers.store(0 */
  :: pullers != k /* @ src/registry/registry.cpp unsubscribe: pullers.load */
  fi;
#endif
  if
  :: formed && who == k + 1 -> /* @ src/recovery/recovery.hpp free_cells: if (r.who[i].load */
#ifdef BLIND_STORE
    who = 0
#else
    if
    :: atomic { who == k + 1 -> who = 0 } /* @ src/recovery/recovery.hpp free_cells: r.who[i].compare_exchange_strong(dead, 0 */
    :: who != k + 1 /* @ src/recovery/recovery.hpp make_idle: if (r.who[i].load */
    fi
#endif
  :: else
  fi;
  if
  :: home == HOME(k) -> home = HOME_ORPHANAGE /* @ src/recovery/recovery.hpp move_home: words.home.store(refcount::kHomeOrphanage */
  :: home != HOME(k) /* @ src/recovery/recovery.hpp move_home: if (words.home.load */
  fi;
  own = own & ~(1 << k); /* @ src/recovery/recovery.hpp let_go: own.fetch_and(~Own::bit(k) */
#ifdef HOLD_FIRST
  if
  :: slot && STATE(writer) == ORPHAN -> own = own | 1
  :: else
  fi;
#endif
#ifdef NAME_BEFORE_COLLECT
  part[k] = 0;
#endif
  collect(); /* @ src/recovery/recovery.hpp reap: collect() */
  part[k] = 0 /* @ src/recovery/recovery.hpp reap: world_.part(k).store(0 */
}

/* ---- wardens ----------------------------------------------------------------------------------- */

#ifdef NO_WITNESS
#define WITNESS_IS_GONE(k) true
#else
#define WITNESS_IS_GONE(k) (witness[k] == NONE)
#endif
#define CAN_BE_REAPED(k) (part[k] && lock[k] == NONE && WITNESS_IS_GONE(k))
/* When a warden looks, and when that would change anything. What makes it look (it is woken by a death,
 * and searches blocks when a reaper has bumped `bequests`) is left out: it looks when there is something. */
#define HAS_ORPHANS (STATE(writer) == ORPHAN || home == HOME_ORPHANAGE)
#define CAN_BE_COLLECTED (HAS_ORPHANS && (IS_DESERTED_ORPHAN && registry == NONE || own & 1 && !IS_NEEDED || home == HOME_ORPHANAGE && own == 0))
#define ALL_HAVE_GONE (ended[PUBLISHER] && ended[READER] && ended[NEWCOMER] && ended[MORTAL_WARDEN])

proctype warden(byte me) {
  byte k, w, q;
  bit needed, dies;
  {
end_idle:
    do
    :: atomic { CAN_BE_REAPED(1) -> k = 1; break } /* @ src/transport/participant_liveness.cpp reap_dead: !lock_file_->held_by_other(k) */
    :: atomic { CAN_BE_REAPED(2) -> k = 2; break } /* @ src/transport/participant_liveness.cpp reap_dead: !lock_file_->held_by_other(k) */
    :: CAN_BE_COLLECTED -> /* @ src/transport/participant_liveness.cpp look_around: reap_dead() || (due && (orphans_ || bequests != bequests_)) || has_deserted_ring() */
      if
      :: atomic { lock[0] == NONE -> lock[0] = me }; /* @ src/transport/participant_liveness.cpp collect: enter_orphanage() */
        collect(); /* @ src/transport/participant_liveness.cpp collect: Recovery(*this).collect() */
        lock[0] = NONE /* @ src/transport/participant_liveness.cpp collect: leave_orphanage() */
      :: !CAN_BE_COLLECTED /* Somebody else was quicker. */
      fi
    :: atomic { me == WARDEN && ALL_HAVE_GONE && !CAN_BE_REAPED(1) && !CAN_BE_REAPED(2) && !CAN_BE_COLLECTED -> goto gone }
    od;
    if
    :: atomic { lock[k] == NONE -> lock[k] = me } /* @ src/transport/participant_liveness.cpp reap_if_dead: lock_file_->try_lock(k) */
    :: else -> k = 0; goto end_idle
    fi;
    if
    :: part[k] -> /* @ src/transport/participant_liveness.cpp reap_if_dead: part(k).load */
      if
      :: atomic { WITNESS_IS_GONE(k) -> witness[k] = me }; /* @ src/transport/participant_liveness.cpp reap_if_dead: witness.try_lock() != RobustMutex::Outcome::Busy */
#ifndef NO_ORPHANAGE_LOCK
        if
        :: atomic { lock[0] == NONE -> lock[0] = me }; /* @ src/transport/participant_liveness.cpp reap_if_dead: enter_orphanage() */
          reap(k); /* @ src/transport/participant_liveness.cpp reap_if_dead: Recovery(*this).reap(k) */
          lock[0] = NONE /* @ src/transport/participant_liveness.cpp reap_if_dead: leave_orphanage() */
        :: else
        fi;
#else
        reap(k);
#endif
        witness[k] = NONE /* @ src/transport/participant_liveness.cpp reap_if_dead: witness.unlock() */
      :: else
      fi
    :: else
    fi;
    atomic {
      lock[k] = NONE; /* @ src/transport/participant_liveness.cpp reap_if_dead: lock_file_->unlock(k) */
      k = 0;
      goto end_idle
    };
gone:
    assert(part[1] == 0 && part[2] == 0);
    assert(STATE(writer) == FREE && memory == 0);
    assert(home == NOBODYS && own == 0);
    ended[me] = 1
  } unless { d_step { dead[me] -> k = 0; w = 0; needed = 0; dies = 0 } }
}

/* Anything that a reaper of k would find. */
#define IS_NAMED(k) (OWNER(writer) == k && STATE(writer) != FREE || formed && who == k + 1 || home == HOME(k) || own >> k & 1)

/* ---- whoever comes ----------------------------------------------------------------------------- */

inline take_index() {
  acquire(gate, me); /* @ src/transport/participant.cpp join: if (!file->enter_gate(kGatePatience)) continue */
  k = 1;
  do
  :: k <= LAST ->
    if
    :: atomic { lock[k] == NONE -> lock[k] = me }; /* @ src/transport/participant_liveness.cpp try_take_index: if (!lock_file_->try_lock(k)) continue */
      if
      :: atomic { WITNESS_IS_GONE(k) -> witness[k] = me }; /* @ src/transport/participant_liveness.cpp try_take_index: witness.try_lock() != RobustMutex::Outcome::Busy */
        if
        :: part[k] == 0 -> clean = 1 /* @ src/transport/participant_liveness.cpp try_take_index: bool clean = part(k).load */
#ifdef TAKEN_WITHOUT_REAP
        :: part[k] -> clean = 1
#else
        :: part[k] -> /* @ src/transport/participant_liveness.cpp try_take_index: bool clean = part(k).load */
          if
          :: atomic { lock[0] == NONE -> lock[0] = me }; /* @ src/transport/participant_liveness.cpp try_take_index: enter_orphanage() */
            reap(k); /* @ src/transport/participant_liveness.cpp try_take_index: Recovery(*this).reap(k) */
            lock[0] = NONE; /* @ src/transport/participant_liveness.cpp try_take_index: leave_orphanage() */
            clean = 1
          :: else
          fi
#endif
        fi;
        witness[k] = NONE /* @ src/transport/participant_liveness.cpp try_take_index: witness.unlock() */
      :: else
      fi;
      if
      :: atomic { clean -> clean = 0; assert(occupant[k] == NONE && !IS_NAMED(k)); occupant[k] = me; break }
      :: else -> lock[k] = NONE /* @ src/transport/participant_liveness.cpp try_take_index: lock_file_->unlock(k) */
      fi
    :: else
    fi;
    k++
#if defined(FULL_TABLE) && !defined(LOOKS_ONCE)
  :: else -> k = 1
#else
  :: else -> break
#endif
  od;
  if
  :: k <= LAST ->
    acquire(witness[k], me); /* @ src/transport/participant_liveness.cpp warden: witness.lock_for(kWitnessPatience) != RobustMutex::Outcome::Busy */
    part[k] = 1 /* @ src/transport/participant_liveness.cpp warden: part(index()).store(1 */
  :: else -> /* @ src/transport/participant_liveness.cpp take_index: throw Error(EUSERS, segment_.path() */
#ifdef FULL_TABLE
    assert(false)
#endif
  fi;
  gate = NONE /* @ src/transport/participant.cpp ~GateGuard: file_->leave_gate() */
}

inline leave() {
  acquire(gate, me); /* @ src/transport/participant_liveness.cpp warden: in_gate = lock_file_->intact() && lock_file_->enter_gate(kGatePatience) */
  occupant[k] = NONE;
  acquire(lock[0], me); /* @ src/transport/participant_liveness.cpp warden: enter_orphanage() */
  reap(k); /* @ src/transport/participant_liveness.cpp warden: Recovery(*this).reap(index()) */
  lock[0] = NONE; /* @ src/transport/participant_liveness.cpp warden: leave_orphanage() */
  witness[k] = NONE; /* @ src/transport/participant_liveness.cpp warden: witness.unlock() */
  lock[k] = NONE; /* @ src/transport/participant_liveness.cpp warden: lock_file_->unlock(index()) */
  gate = NONE /* @ src/transport/participant_liveness.cpp warden: lock_file_->leave_gate() */
}

/* The memory of a new ring may hold anything. */
inline kernel_garbage() {
  if
  :: who = 0
  :: who = INDEXES
  fi;
  if
  :: slot = 0
  :: slot = 1
  fi
}

#ifdef SUBSCRIBED
/* One that had subscribed has a cell from the start; one that has died loses it again. */
inline await_puller() {
  if
  :: pullers -> /* @ src/lockfree_ring/ring.hpp await_pullers: const std::uint32_t count = pullers(p) */
    who = pullers + 1; /* @ src/lockfree_ring/ring.hpp await: who[c].store(participant + 1 */
#ifndef NO_SECOND_LOOK
    if
    :: !pullers -> who = 0 /* @ src/lockfree_ring/ring.hpp await_pullers: if (!subscribes(p)) await_no_more(c) */
    :: pullers /* @ src/lockfree_ring/ring.hpp await_pullers: if (!subscribes(p)) await_no_more(c) */
    fi
#endif
  :: !pullers /* @ src/lockfree_ring/ring.hpp await_pullers: const std::uint32_t count = pullers(p) */
  fi
}
#endif

inline open() {
  acquire(registry, me); /* @ src/transport/participant_stock.cpp open_ring: const registry::Registry::Lock lock(registry_) */
  if
  :: atomic { STATE(writer) == FREE -> writer = WRITER(GENERATION(writer) + 1, INIT, k) }; /* @ src/registry/registry.cpp open: ring::make_writer(generation, ring::State::Init, participant) */
    atomic { memory = 1; kernel_garbage() }; /* @ src/registry/registry.cpp open: entry.granule = segment_.claim_run(entry.granules, segment::kRingTag | c) */
    slot = 0; /* @ src/lockfree_ring/ring.hpp format: slots[i].store(make( */
    who = 0; /* @ src/lockfree_ring/ring.hpp format: who[c].store(0 */
    formed = 1; /* @ src/registry/registry.cpp open: entry.formed.store(1 */
#ifdef SUBSCRIBED
    await_puller(); /* @ src/registry/registry.cpp open: ring.await_pullers(segment_.capacity().participants */
#endif
    writer = WRITER(GENERATION(writer), LIVE, k); /* @ src/registry/registry.cpp open: ring::make_writer(generation, ring::State::Live, participant) */
    opened = 1
  :: STATE(writer) != FREE /* @ src/registry/registry.cpp open: if (ring::writer_state(w) != ring::State::Free) continue */
  fi;
  registry = NONE /* @ src/registry/registry.cpp ~Lock: registry_.unlock() */
}

inline publish() {
  if
#ifdef FORWARDED
  :: own = own | 1 << k; /* @ src/refcount/ownership.hpp acquire: own(b).fetch_or(own_bit_ */
    atomic { slot = 1; message = 1 } /* @ src/lockfree_ring/ring.hpp publish: slot.exchange(make(next_, block) */
#else
  :: atomic { home == HOME_FREE -> home = HOME(k) }; /* @ src/refcount/ownership.hpp claim: b.home.compare_exchange_strong(free, self + 1 */
    own = own | 1 << k; /* @ src/refcount/ownership.hpp claim: own(b).fetch_or(own_bit_ */
    atomic { slot = 1; message = 1 } /* @ src/lockfree_ring/ring.hpp publish: slot.exchange(make(next_, block) */
  :: home != HOME_FREE /* @ src/refcount/ownership.hpp claim: b.home.load */
#endif
  fi
}

proctype publisher(byte me) {
  byte k, w, q;
  bit needed, dies, clean, opened;
  {
    if
#ifndef ANY_TIME
    :: me == NEWCOMER -> ended[PUBLISHER]
#endif
    :: else
    fi;
    take_index(); /* @ src/transport/participant.cpp Participant: HardwareOwnership(take_index(options)) */
    if
    :: k > LAST -> goto gone
    :: else
    fi;
    open(); /* @ src/transport/participant_stock.cpp open_ring: name = registry_.open(topic, index(), options) */
    if
    :: opened -> publish() /* @ src/transport/pusher.cpp publish: writer_->publish(b) */
    :: else
    fi;
#ifdef CLOSEFROM
    if
    :: me == PUBLISHER ->
      lock[k] = NONE; /* kernel: closefrom() in the application */
      acquire(lock[k], me) /* @ src/transport/participant_liveness.cpp keep_own_lock: if (lock_lost_) lock_lost_ = !lock_file_->try_lock(index()) */
    :: else
    fi;
#endif
#ifdef SUBSCRIBED
    /* It reads its own ring as well, if there is a cell: that one is its own until it leaves. */
    if
    :: atomic { opened && who == 0 -> who = k + 1 }; /* @ src/lockfree_ring/ring.hpp join: ring.who[c].compare_exchange_strong(nobody, participant + 1 */
      atomic { assert(who == k + 1); who = 0 } /* @ src/lockfree_ring/ring.hpp free_cell: who[c].store(0 */
    :: !opened || who != 0 /* @ src/lockfree_ring/ring.hpp join: ring.who[c].compare_exchange_strong(nobody, participant + 1 */
    fi;
#endif
    leave(); /* @ src/transport/participant.cpp leave: warden_.join() */
gone:
    atomic { ended[me] = 1; k = 0; opened = 0 }
  } unless { d_step { dead[me] -> k = 0; w = 0; needed = 0; dies = 0; clean = 0; opened = 0 } }
}

proctype reader(byte me) {
  byte k, w, q;
  bit needed, dies, clean;
  {
#ifdef READER_IS_SETTLED
    if
    :: atomic { STATE(writer) == LIVE -> k = INDEXES; who = k + 1; inside = 1 } /* @ src/lockfree_ring/ring.hpp join: ring.who[c].compare_exchange_strong(nobody, participant + 1 */
    :: ended[PUBLISHER] -> goto gone
    fi;
#else
    take_index(); /* @ src/transport/participant.cpp Participant: HardwareOwnership(take_index(options)) */
    if
    :: k > LAST -> goto gone
    :: else
    fi;
#ifndef JOINER_TAKES_NO_LOCK
    acquire(registry, me); /* @ src/transport/puller.cpp subscribe: const registry::Registry::Lock lock(participant_->registry()) */
#endif
#ifdef SUBSCRIBED
    pullers = k; /* @ src/registry/registry.cpp add_puller: pullers[participant].fetch_add(1 */
#endif
    atomic {
      w = writer; /* @ src/registry/registry.cpp rings: const auto w = channels[c].writer.load */
      if
      :: STATE(w) != LIVE -> w = 0; goto joined
      :: else
      fi
    };
    atomic {
      assert(memory);
      if
      :: who == 0 -> who = k + 1 /* @ src/lockfree_ring/ring.hpp join: ring.who[c].compare_exchange_strong(nobody, participant + 1 */
      :: else -> w = 0; goto joined
      fi
    };
    if
    :: atomic { GENERATION(writer) == GENERATION(w) && STATE(writer) == LIVE -> inside = 1 } /* @ src/lockfree_ring/ring.hpp join: if (!is_open || writer_generation(writer) != generation) */
    :: else -> assert(memory); who = 0 /* @ src/lockfree_ring/ring.hpp join: ring.who[c].store(0 */
    fi;
    w = 0;
joined:
#ifndef JOINER_TAKES_NO_LOCK
    registry = NONE; /* @ src/registry/registry.cpp ~Lock: registry_.unlock() */
#endif
#endif
#ifdef SUBSCRIBED
    /* It looks again later: at a ring that has come meanwhile, and may have ended. */
    acquire(registry, me); /* @ src/transport/puller.cpp find_new_rings: if (!registry.try_lock()) */
    if
    :: STATE(writer) >= LIVE && !inside && formed && who == k + 1 -> inside = 1; assert(memory) /* @ src/lockfree_ring/ring.hpp adopt: ring.who[c].load */
    :: STATE(writer) < LIVE || inside || !formed || who != k + 1 /* @ src/lockfree_ring/ring.hpp adopt: ring.who[c].load */
    fi;
    registry = NONE; /* @ src/transport/puller.cpp find_new_rings: registry.unlock() */
#endif
    if
    :: inside && slot -> /* @ src/lockfree_ring/ring.hpp poll: place(slot.load */
      assert(message);
      own = own | 1 << k; /* @ src/refcount/ownership.hpp acquire: own(b).fetch_or(own_bit_ */
      assert(message)
    :: else
    fi;
    if
    :: atomic { inside -> assert(memory); who = 0; inside = 0 } /* @ src/lockfree_ring/ring.hpp free_cell: who[c].store(0 */
    :: else
    fi;
    if
    :: own & 1 << k -> /* @ src/refcount/ownership.hpp let_go: own(b).fetch_and(~own_bit_ */
      assert(message);
      own = own & ~(1 << k) /* @ src/refcount/ownership.hpp let_go: own(b).fetch_and(~own_bit_ */
    :: else
    fi;
#ifndef READER_IS_SETTLED
    leave(); /* @ src/transport/participant.cpp leave: warden_.join() */
#endif
gone:
    atomic { ended[me] = 1; k = 0 }
  } unless { d_step { dead[me] -> k = 0; w = 0; needed = 0; dies = 0; clean = 0 } }
}

/* ---- fate -------------------------------------------------------------------------------------- */

/* Kills, or loses the wish to. */
proctype kernel_fate(byte p) {
  byte q;
  if
  :: atomic { !ended[p] -> kernel_kills(p) };
    if
    :: kernel_drops_robust_locks(p); kernel_drops_files(p)
    :: kernel_drops_files(p); kernel_drops_robust_locks(p)
    fi;
    ended[p] = 1
  :: true
  fi
}

init {
  byte p;
  atomic {
    run publisher(PUBLISHER);
#ifdef READER_COMES
    run reader(READER);
#else
    ended[READER] = 1;
#endif
#ifdef NEWCOMER_COMES
    run publisher(NEWCOMER);
#else
    ended[NEWCOMER] = 1;
#endif
#ifdef TWO_WARDENS
    run warden(MORTAL_WARDEN);
#else
    ended[MORTAL_WARDEN] = 1;
#endif
    run warden(WARDEN);
    for (p : PUBLISHER .. MORTAL_WARDEN) {
      if
      :: MORTALS >> p & 1 -> run kernel_fate(p)
      :: else
      fi
    }
    p = 0
  }
}
