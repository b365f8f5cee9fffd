// SPDX-License-Identifier: Apache-2.0
/* Joining, leaving and reaping: nothing of the living is touched, nothing of the dead is left.
 *
 * A publisher takes an index, opens the ring and publishes; a reader takes another index, joins and
 * keeps a message; a newcomer comes when the publisher has gone and opens the ring anew. Each leaves
 * cleanly, or is killed after any step. Wardens reap and collect, and one of them may be killed too.
 * The last warden looks when all have gone: whatever is left then is lost for ever.
 *
 * One channel with one cell, one block, two indexes. Sleepers are the business of sleep_wake.pml, the
 * files that of creation.pml. That the witness thread links its node, and then takes the seat, is one
 * step: a node that is linked to a seat of another thread changes nothing.
 *
 * run restart -DNEWCOMER_COMES -DMORTALS=2 : the publisher is killed or leaves, and is started again
 * run reapers -DREADER_COMES -DREADER_IS_SETTLED -DTWO_WARDENS -DMORTALS=18 : the publisher and who reaps it are killed
 * run readers -DREADER_COMES -DMORTALS=4 : the reader is killed, wherever the publisher is
 * run lost_lock -DNEWCOMER_COMES -DANY_TIME -DCLOSEFROM : the publisher loses its kernel lock and lives
 * run overlap -DREADER_COMES -DREADER_IS_SETTLED -DNEWCOMER_COMES -DANY_TIME -DMORTALS=2 : others come and leave while the publisher is reaped
 * run forwarded -DFORWARDED -DNEWCOMER_COMES -DMORTALS=10 : publishers of somebody else's message leave and are killed
 * run full_table -DNEWCOMER_COMES -DMORTALS=2 -DFULL_TABLE : a newcomer finds every index taken, one by somebody dead
 * run subscribed -DSUBSCRIBED -DREADER_COMES -DANY_TIME -DMORTALS=6 : a subscriber that may die gets a cell in a ring that comes later
 * run two_files -DNEWCOMER_COMES -DANY_TIME -DTWO_WARDENS -DTWO_FILES -DMORTALS=2 : somebody has removed the lock file: the newcomer and one of the wardens lock another one
 * run overlap_files -DREADER_COMES -DREADER_IS_SETTLED -DNEWCOMER_COMES -DANY_TIME -DTWO_FILES -DMORTALS=2 : the same; the newcomer comes and leaves while the publisher is reaped
 * full everybody -DREADER_COMES -DNEWCOMER_COMES -DMORTALS=2 : all three, and the publisher may be killed
 * full reader_and_publisher -DREADER_COMES -DMORTALS=6 : both may be killed
 *
 * pan -DCOLLAPSE
 *
 * plant NO_WITNESS lost_lock : a free byte alone counts as death
 * plant TAKEN_WITHOUT_REAP full_table : the new owner of an index does not repair what the dead one left
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
 * plant NO_ORPHANAGE_WORD overlap_files : who acts for the orphanage has its byte alone
 * plant JUDGES_ONCE two_files : a reaper does not look again, in the orphanage, whether it is still that one
 * plant TAKEN_UNSEEN two_files : who takes a seat does not look whether it is still the one that was free
 * plant NO_TAKE_OVER readers : the lock of a dead one stays its own
 * plant OLD_NAME readers : who takes an index locks in the name of the one before
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

/* Two lock files, when somebody has removed one. */
#define LOCKS (2 * INDEXES)
#ifdef TWO_FILES
#define FILE(p) ((p) == NEWCOMER || (p) == MORTAL_WARDEN -> 1 : 0)
#else
#define FILE(p) 0
#endif
#define BYTE(p, k) lock[FILE(p) * INDEXES + (k)]

/* A seat: {incarnation, notice}; a notice: nobody, the process that stands, or: */
#define DIED 6
#define JUDGED 7
#define SEAT(incarnation, notice) ((incarnation) << 3 | (notice))
#define INCARNATION(s) ((s) >> 3)
#define NOTICE(s) ((s) & 7)
#ifdef NO_WITNESS
#define STANDS(s) false
#else
#define STANDS(s) (NOTICE(s) != NONE && NOTICE(s) < DIED)
#endif
/* The name in a lock: {incarnation, index}. Who comes without an index (wardens, a settled reader) has a
 * number of its own, and its death is seen when the kernel has done all. */
#define NAME(incarnation, k) ((incarnation) << 3 | (k))
#define INDEXLESS(p) ((p) + 1)
#define SEAT_OF(n) seat[(n) & 7]
#define SEAT_IS_GONE(n, p) (INCARNATION(SEAT_OF(n)) != (n) >> 3 || NOTICE(SEAT_OF(n)) == JUDGED || !STANDS(SEAT_OF(n)) && BYTE(p, (n) & 7) == NONE)
#define IS_GONE(n, p) (((n) & 7) < INDEXES -> SEAT_IS_GONE(n, p) : kernel_done[((n) & 7) - 1])
#ifdef NO_TAKE_OVER
#define CAN_LOCK(word, p) ((word) == NONE)
#else
#define CAN_LOCK(word, p) ((word) == NONE || IS_GONE(word, p))
#endif

/* shared */
byte gate[2];       /* kernel locks on bytes of the lock files, by process */
byte lock[LOCKS];
byte seat[INDEXES]; /* incarnation and notice */
byte registry;      /* lock words: names */
byte orphanage;
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
bit kernel_done[PROCESSES];    /* and the kernel has dropped all that it had */
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

/* Then it gives notice, and drops its files, one after the other. */
inline kernel_gives_notice(p) {
  d_step {
    for (q : 1 .. INDEXES - 1) {
      if
      :: NOTICE(seat[q]) == p -> seat[q] = SEAT(INCARNATION(seat[q]), DIED)
      :: else
      fi
    }
    q = 0
  }
}

inline kernel_drops_files(p) {
  d_step {
    for (q : 0 .. LOCKS - 1) {
      if
      :: lock[q] == p -> lock[q] = NONE
      :: else
      fi
    }
    for (q : 0 .. 1) {
      if
      :: gate[q] == p -> gate[q] = NONE
      :: else
      fi
    }
    q = 0
  }
}

inline acquire(word, p) { atomic { (word) == NONE -> word = p } }
/* A lock word; a living process has what it holds. */
inline acquire_lock(word) { atomic { CAN_LOCK(word, me) -> word = name } }
inline release_lock(word) { atomic { assert(word == name); word = NONE } }

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
    :: atomic { CAN_LOCK(registry, me) -> registry = name } /* @ src/recovery/recovery.hpp recycle_rings: if (!world_.lock_rings()) return false */
    :: else -> goto unrecycled
    fi;
#endif
    if
    :: IS_DESERTED_ORPHAN -> /* @ src/recovery/recovery.hpp recycle_rings: if (!is_deserted_orphan(c)) continue */
      recycle(); /* @ src/recovery/recovery.hpp recycle_rings: world_.recycle_ring(c) */
      writer = WRITER(GENERATION(writer) + 1, FREE, 0) /* @ src/recovery/recovery.hpp recycle_rings: world_.channel_writer(c).free(ring::writer_generation(w) + 1) */
    :: else
    fi;
#ifndef NO_REGISTRY_LOCK
    release_lock(registry) /* @ src/recovery/recovery.hpp recycle_rings: world_.unlock_rings() */
#endif
  :: else
  fi;
unrecycled:
  if
  :: IS_NEEDED -> needed = 1 /* @ src/recovery/recovery.hpp mark_needed: need(ring::block(r.slots[i].load */
  :: else
  fi;
  if
  :: own & 1 && !needed -> /* @ src/recovery/recovery.hpp collect: if (!needed_[b]) Own::let_go */
    own = own & ~1 /* @ src/refcount/ownership.hpp let_go: own.fetch_and(~bit(k) */
  :: else
  fi;
  atomic {
    needed = 0;
    if
    :: home == HOME_ORPHANAGE && own == 0 -> /* @ src/recovery/recovery.hpp free_dead_messages: !Own::die_in_orphanage(words) */
      message = 0;
      dies = 1
    :: else
    fi
  };
  if
  :: dies ->
    atomic {
      home = HOME_FREE; /* @ src/refcount/ownership.hpp free_orphan: b.home.store(kHomeFree */
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
    writer = WRITER(GENERATION(w) + 1, FREE, 0) /* @ src/recovery/recovery.hpp orphan_ring: writer.free(generation + 1) */
  :: else ->
#ifdef RING_NAME_FIRST
    writer = WRITER(GENERATION(w), ORPHAN, 0);
#else
    writer = WRITER(GENERATION(w), ORPHAN, k); /* @ src/recovery/recovery.hpp orphan_ring: writer.end(generation, k) */
#endif
#ifndef HOLD_FIRST
    if
    :: slot -> own = own | 1 /* @ src/refcount/ownership.hpp adopt: b.own[0].fetch_or(1 */
    :: !slot /* @ src/recovery/recovery.hpp orphan_ring: adopt(ring::block(r.slots[i].load */
    fi;
#endif
    writer = WRITER(GENERATION(w), ORPHAN, 0) /* @ src/recovery/recovery.hpp orphan_ring: writer.give_to_orphanage(generation, refcount::kOrphanage) */
  fi;
  w = 0;
kept:
  skip
}

/* By who has its byte, and by who has its word. */
inline leave_orphanage() {
#ifndef NO_ORPHANAGE_WORD
  release_lock(orphanage); /* @ src/transport/reaper.cpp leave_orphanage: RobustMutex(segment_.directory().orphanage.word, presence_).unlock() */
#endif
  BYTE(me, 0) = NONE /* @ src/transport/reaper.cpp leave_orphanage: lock_file_.unlock(refcount::kOrphanage) */
}
#ifdef NO_ORPHANAGE_WORD
#define CAN_ENTER_ORPHANAGE (BYTE(me, 0) == NONE)
#else
#define CAN_ENTER_ORPHANAGE (BYTE(me, 0) == NONE && CAN_LOCK(orphanage, me))
#endif
/* The byte first, then the word; who finds the word locked gives the byte back: nobody has seen more than
 * that it was locked for a moment. So it is one step. REQUIRES: CAN_ENTER_ORPHANAGE. */
inline enters_orphanage() {
  BYTE(me, 0) = me; /* @ src/transport/reaper.cpp enter_orphanage: lock_file_.try_lock(refcount::kOrphanage) */
  orphanage = name /* @ src/transport/reaper.cpp enter_orphanage: mutex.try_lock() != RobustMutex::Outcome::Busy */
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
  :: home == HOME(k) -> home = HOME_ORPHANAGE /* @ src/refcount/ownership.hpp move_to_orphanage: b.home.store(kHomeOrphanage */
  :: home != HOME(k) /* @ src/recovery/recovery.hpp move_home: if (words.home.load */
  fi;
  own = own & ~(1 << k); /* @ src/refcount/ownership.hpp let_go: own.fetch_and(~bit(k) */
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
  part[k] = 0 /* @ src/recovery/recovery.hpp reap: world_.participant_state(k).free() */
}

/* ---- wardens ----------------------------------------------------------------------------------- */

#define CAN_BE_REAPED(k) (part[k] && BYTE(me, k) == NONE && !STANDS(seat[k]))
/* When a warden looks, and when that would change anything. What makes it look (it is woken by a death,
 * and searches blocks when a reaper has bumped `adoptions`) is left out: it looks when there is something. */
#define HAS_ORPHANS (STATE(writer) == ORPHAN || home == HOME_ORPHANAGE)
#define CAN_BE_COLLECTED (HAS_ORPHANS && (IS_DESERTED_ORPHAN && CAN_LOCK(registry, me) || own & 1 && !IS_NEEDED || home == HOME_ORPHANAGE && own == 0))
#define ALL_HAVE_GONE (ended[PUBLISHER] && ended[READER] && ended[NEWCOMER] && ended[MORTAL_WARDEN])

proctype warden(byte me) {
  byte k, w, q, name = INDEXLESS(me);
  bit needed, dies;
  {
end_idle:
    do
    :: atomic { CAN_BE_REAPED(1) -> k = 1; break } /* @ src/transport/reaper.cpp looks_dead: presence_.looks_dead(k) */
    :: atomic { CAN_BE_REAPED(2) -> k = 2; break } /* @ src/transport/reaper.cpp looks_dead: presence_.looks_dead(k) */
    :: CAN_BE_COLLECTED -> /* @ src/transport/warden.cpp look_around: reaper_.reap_dead() || (due && (orphans_ || adoptions != adoptions_)) || reaper_.has_deserted_ring() */
      if
      :: atomic { CAN_ENTER_ORPHANAGE -> enters_orphanage() }; /* @ src/transport/reaper.cpp collect: enter_orphanage() */
        collect(); /* @ src/transport/reaper.cpp collect: Recovery(world_).collect() */
        leave_orphanage() /* @ src/transport/reaper.cpp collect: leave_orphanage() */
      :: !CAN_BE_COLLECTED /* Somebody else was quicker. */
      fi
    :: atomic { me == WARDEN && ALL_HAVE_GONE && !CAN_BE_REAPED(1) && !CAN_BE_REAPED(2) && !CAN_BE_COLLECTED -> goto gone }
    od;
    if
    :: atomic { BYTE(me, k) == NONE -> BYTE(me, k) = me } /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.try_lock(k) */
    :: else -> k = 0; goto end_idle
    fi;
    if
    :: part[k] -> /* @ src/transport/reaper.cpp reap_if_dead: world_.participant_state(k).load */
      if
      :: atomic { !STANDS(seat[k]) -> seat[k] = SEAT(INCARNATION(seat[k]), JUDGED) }; /* @ src/liveness/presence.cpp judge: DeathNotice::judge(seat_of(k), seat) */
#ifndef NO_ORPHANAGE_LOCK
        if
        :: atomic { CAN_ENTER_ORPHANAGE -> enters_orphanage() }; /* @ src/transport/reaper.cpp reap_if_dead: enter_orphanage() */
          if
#ifdef JUDGES_ONCE
          :: true ->
#else
          :: atomic { part[k] && NOTICE(seat[k]) == JUDGED -> skip }; /* @ src/transport/reaper.cpp reap_if_dead: world_.participant_state(k).load(std::memory_order_acquire) != 0 && presence_.is_judged(k) */
#endif
            reap(k) /* @ src/transport/reaper.cpp reap_if_dead: Recovery(world_).reap(k) */
#ifndef JUDGES_ONCE
          :: else
#endif
          fi;
          leave_orphanage() /* @ src/transport/reaper.cpp reap_if_dead: leave_orphanage() */
        :: else
        fi
#else
        reap(k)
#endif
      :: else
      fi
    :: else
    fi;
    atomic {
      BYTE(me, k) = NONE; /* @ src/transport/reaper.cpp reap_if_dead: lock_file_.unlock(k) */
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

/* Of a dead one, or not: first those that are not. */
#define MAY_TAKE(k) (part[k] == of_a_dead_one && !STANDS(seat[k]))

inline take_index() {
  acquire(gate[FILE(me)], me); /* @ src/transport/gate.cpp pass_gate: if (!file->enter_gate(kGatePatience)) continue */
  k = 1;
  do
  :: k <= LAST ->
    if
    :: MAY_TAKE(k) -> /* @ src/transport/membership.cpp try_take_index: return is_clean != of_a_dead_one && presence_.may_be_claimed(k) */
      if
      :: atomic { BYTE(me, k) == NONE -> BYTE(me, k) = me }; /* @ src/transport/membership.cpp try_take_index: !lock_file_->try_lock(k) */
        atomic {
          w = seat[k]; /* @ src/liveness/presence.cpp claim: const std::uint64_t seat = seen(k) */
          if
          :: MAY_TAKE(k) /* @ src/transport/membership.cpp try_take_index: if (may_take(k) && presence_.claim(k)) */
          :: else -> goto untaken
          fi
        };
        atomic {
          if
#ifdef TAKEN_UNSEEN
          :: seat[k] = SEAT(INCARNATION(w) + 1, me)
#else
          :: seat[k] == w -> seat[k] = SEAT(INCARNATION(w) + 1, me) /* @ src/liveness/death_notice.cpp take: seat_->compare_exchange_strong(seen_, ours */
          :: else -> goto untaken
#endif
          fi
        };
#ifdef OLD_NAME
        name = NAME(INCARNATION(w), k);
#else
        name = NAME(INCARNATION(w) + 1, k);
#endif
        w = 0;
        if
        :: part[k] == 0 -> clean = 1 /* @ src/transport/reaper.cpp repair_index: if (world_.participant_state(index()).load(std::memory_order_acquire) == 0) return true */
#ifdef TAKEN_WITHOUT_REAP
        :: part[k] -> clean = 1
#else
        :: part[k] -> /* @ src/transport/reaper.cpp repair_index: if (world_.participant_state(index()).load(std::memory_order_acquire) == 0) return true */
          if
          :: atomic { CAN_ENTER_ORPHANAGE -> enters_orphanage() }; /* @ src/transport/reaper.cpp repair_index: while (!enter_orphanage()) */
            if
            :: part[k] -> reap(k) /* @ src/transport/reaper.cpp repair_index: Recovery(world_).reap(index()) */
            :: part[k] == 0 /* @ src/transport/reaper.cpp repair_index: if (world_.participant_state(index()).load(std::memory_order_acquire) != 0) */
            fi;
            leave_orphanage(); /* @ src/transport/reaper.cpp repair_index: leave_orphanage() */
            clean = 1
#if !defined(FULL_TABLE) || defined(LOOKS_ONCE)
          :: else /* its patience has ended */
#endif
          fi
#endif
        fi;
        if
        :: atomic { clean -> clean = 0; assert(occupant[k] == NONE && !IS_NAMED(k)); occupant[k] = me; break }
        :: else -> give_up_seat() /* @ src/transport/membership.cpp try_take_index: presence_.end() */
        fi;
untaken:
        w = 0;
        BYTE(me, k) = NONE /* @ src/transport/membership.cpp try_take_index: lock_file_->unlock(k) */
      :: else
      fi
    :: !MAY_TAKE(k) /* @ src/transport/membership.cpp try_take_index: return is_clean != of_a_dead_one && presence_.may_be_claimed(k) */
    fi;
    k++
  :: atomic { k > LAST && !of_a_dead_one -> k = 1; of_a_dead_one = 1 }
#if defined(FULL_TABLE) && !defined(LOOKS_ONCE)
  :: atomic { k > LAST && of_a_dead_one -> k = 1; of_a_dead_one = 0 }
#else
  :: k > LAST && of_a_dead_one -> break
#endif
  od;
  of_a_dead_one = 0;
  if
  :: k <= LAST ->
    part[k] = 1 /* @ src/transport/membership.cpp take_index: participant_state(index()).take() */
  :: else -> /* @ src/transport/membership.cpp take_index: throw Error(EUSERS, segment_.path() */
#ifdef FULL_TABLE
    assert(false)
#endif
  fi;
  gate[FILE(me)] = NONE /* @ src/transport/gate.cpp ~GateGuard: file_->leave_gate() */
}

inline give_up_seat() {
  atomic {
    assert(NOTICE(seat[k]) == me);
    seat[k] = SEAT(INCARNATION(seat[k]), NONE) /* @ src/liveness/death_notice.cpp run: order == Order::Renew ? ours_ : seat::make(seat::incarnation(ours_), 0) */
  }
}

inline leave() {
  acquire(gate[FILE(me)], me); /* @ src/transport/warden.cpp leave: in_gate = lock_file_.intact() && lock_file_.enter_gate(kGatePatience) */
  occupant[k] = NONE;
  atomic { CAN_ENTER_ORPHANAGE -> enters_orphanage() }; /* @ src/transport/reaper.cpp reap_own: enter_orphanage() */
  reap(k); /* @ src/transport/reaper.cpp reap_own: Recovery(world_).reap(index()) */
  leave_orphanage(); /* @ src/transport/reaper.cpp reap_own: leave_orphanage() */
  give_up_seat(); /* @ src/transport/warden.cpp leave: presence_.end() */
  BYTE(me, k) = NONE; /* @ src/transport/warden.cpp leave: lock_file_.unlock(index()) */
  gate[FILE(me)] = NONE /* @ src/transport/warden.cpp leave: lock_file_.leave_gate() */
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
  acquire_lock(registry); /* @ src/transport/rings.cpp open: const registry::Registry::Lock lock(registry_) */
  if
  :: atomic { STATE(writer) == FREE -> writer = WRITER(GENERATION(writer) + 1, INIT, k) }; /* @ src/registry/registry.cpp open: entry.writer.claim(w, participant) */
    atomic { memory = 1; kernel_garbage() }; /* @ src/registry/registry.cpp open: segment_.claim_run(granules, segment::kRingTag | c) */
    slot = 0; /* @ src/lockfree_ring/ring.hpp format: slots.format(i, advance(first, i), before) */
    who = 0; /* @ src/lockfree_ring/ring.hpp format: who[c].store(0 */
    formed = 1; /* @ src/registry/registry.cpp open: entry.formed.store(1 */
#ifdef SUBSCRIBED
    await_puller(); /* @ src/registry/registry.cpp open: ring.await_pullers(segment_.capacity().participants */
#endif
    writer = WRITER(GENERATION(writer), LIVE, k); /* @ src/registry/registry.cpp open: entry.writer.go_live(generation, participant) */
    opened = 1
  :: STATE(writer) != FREE /* @ src/registry/registry.cpp open: if (ring::writer_state(w) != ring::State::Free) continue */
  fi;
  release_lock(registry) /* @ src/registry/registry.cpp ~Lock: registry_.unlock() */
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
  byte k, w, q, name;
  bit needed, dies, clean, opened, of_a_dead_one;
  {
    if
#ifndef ANY_TIME
    :: me == NEWCOMER -> ended[PUBLISHER]
#endif
    :: else
    fi;
    take_index(); /* @ src/transport/participant.cpp take_index: membership_.take_index(name */
    if
    :: k > LAST -> goto gone
    :: else
    fi;
    open(); /* @ src/transport/rings.cpp open: name = registry_.open(topic, holder_.own.self, options) */
    if
    :: opened -> publish() /* @ src/transport/pusher.cpp publish: writer_->publish(b) */
    :: else
    fi;
#ifdef CLOSEFROM
    if
    :: me == PUBLISHER ->
      BYTE(me, k) = NONE; /* kernel: closefrom() in the application */
      acquire(BYTE(me, k), me) /* @ src/transport/reaper.cpp keep_own_lock: if (lock_lost_) lock_lost_ = !lock_file_.try_lock(index()) */
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
    leave(); /* @ src/transport/participant.cpp leave: warden_.stop() */
gone:
    atomic { ended[me] = 1; k = 0; opened = 0 }
  } unless { d_step { dead[me] -> k = 0; w = 0; needed = 0; dies = 0; clean = 0; opened = 0; of_a_dead_one = 0 } }
}

proctype reader(byte me) {
  byte k, w, q, name = INDEXLESS(me);
  bit needed, dies, clean, of_a_dead_one;
  {
#ifdef READER_IS_SETTLED
    if
    :: atomic { STATE(writer) == LIVE -> k = INDEXES; who = k + 1; inside = 1 } /* @ src/lockfree_ring/ring.hpp join: ring.who[c].compare_exchange_strong(nobody, participant + 1 */
    :: ended[PUBLISHER] -> goto gone
    fi;
#else
    take_index(); /* @ src/transport/participant.cpp take_index: membership_.take_index(name */
    if
    :: k > LAST -> goto gone
    :: else
    fi;
#ifndef JOINER_TAKES_NO_LOCK
    acquire_lock(registry); /* @ src/transport/puller.cpp subscribe: const registry::Registry::Lock lock(participant_->registry()) */
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
    release_lock(registry); /* @ src/registry/registry.cpp ~Lock: registry_.unlock() */
#endif
#endif
#ifdef SUBSCRIBED
    /* It looks again later: at a ring that has come meanwhile, and may have ended. */
    acquire_lock(registry); /* @ src/transport/puller.cpp find_new_rings: if (!registry.try_lock()) */
    if
    :: STATE(writer) >= LIVE && !inside && formed && who == k + 1 -> inside = 1; assert(memory) /* @ src/lockfree_ring/ring.hpp take_awaited: ring.who[c].load */
    :: STATE(writer) < LIVE || inside || !formed || who != k + 1 /* @ src/lockfree_ring/ring.hpp take_awaited: ring.who[c].load */
    fi;
    release_lock(registry); /* @ src/transport/puller.cpp find_new_rings: registry.unlock() */
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
    :: own & 1 << k -> /* @ src/refcount/ownership.hpp clear_own_bit: own(b).fetch_and(~own_bit_ */
      assert(message);
      own = own & ~(1 << k) /* @ src/refcount/ownership.hpp clear_own_bit: own(b).fetch_and(~own_bit_ */
    :: else
    fi;
#ifndef READER_IS_SETTLED
    leave(); /* @ src/transport/participant.cpp leave: warden_.stop() */
#endif
gone:
    atomic { ended[me] = 1; k = 0 }
  } unless { d_step { dead[me] -> k = 0; w = 0; needed = 0; dies = 0; clean = 0; of_a_dead_one = 0 } }
}

/* ---- fate -------------------------------------------------------------------------------------- */

/* Kills, or loses the wish to. */
proctype kernel_fate(byte p) {
  byte q;
  if
  :: atomic { !ended[p] -> kernel_kills(p) };
    if
    :: kernel_gives_notice(p); kernel_drops_files(p)
    :: kernel_drops_files(p); kernel_gives_notice(p)
    fi;
    atomic { kernel_done[p] = 1; ended[p] = 1 }
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
