// SPDX-License-Identifier: Apache-2.0
/* Creation: a segment is absent or complete, and goes with the last one who uses it.
 *
 * Processes open the segment, use it and leave, twice each, and are killed after any step. Nobody
 * ever maps an unfinished segment; who uses a segment of that name uses the same one as everybody
 * else; nobody's segment is removed; and when the last one to leave leaves by itself, no file stays.
 *
 * A file is an inode: names point to it, and the kernel's locks belong to it, so that a lock on a
 * file that was removed meanwhile locks nothing. Everything is sequentially consistent here. How long
 * the gate is waited for is left out: nobody is stopped in this model, only killed.
 *
 * run two -DPROCESSES=2 -DLIVES=2 -DKILLS=2 : two processes, two lives each, two kills
 * run three -DPROCESSES=3 -DLIVES=1 -DKILLS=1 : three processes that come and go at once
 * full three_killed -DPROCESSES=3 -DLIVES=1 -DKILLS=2 : and two of them are killed
 *
 * plant NO_GATE two : opening and leaving exclude nobody
 * plant NO_INODE_CHECK two : the gate of a removed lock file counts
 * plant CREATE_THEN_FILL two : the segment is made under its own name
 * plant UNLINK_WITHOUT_LOOK two : who leaves removes the files, whoever else is there
 * plant GATE_LEFT_FIRST two : the gate is left before the own byte is unlocked
 * plant UNFINISHED_IS_USED two : what a killed creator left is taken for a segment
 */

#ifndef PROCESSES
#define PROCESSES 2
#endif
#ifndef LIVES
#define LIVES 2
#endif
#ifndef KILLS
#define KILLS 2
#endif

#define NONE 0
#define INODES (PROCESSES + 4)

/* shared */
byte lock_name;    /* the inode that NAME.lock points to */
byte segment_name; /* NAME */
byte unfinished;   /* NAME.new */

/* kernel */

/* Inodes of lock files: the kernel's locks, by their owners. Bytes: one a participant. */
byte gate[INODES];
byte locked[INODES * (PROCESSES + 1)];
#define BYTE(inode, k) locked[(inode) * (PROCESSES + 1) + (k)]

/* Inodes of segments. */
byte complete[INODES];
byte parts[INODES]; /* part[k], a bit each */

/* What a process has open; also for choosing an inode that nobody has. */
byte lock_file[PROCESSES + 1];
byte mapped[PROCESSES + 1];
byte held[PROCESSES + 1]; /* index */
bit joined[PROCESSES + 1];

/* ghost */
byte kills = KILLS;
bit dying[PROCESSES + 1];
byte alive = 0;   /* processes that are at it */
byte to_come = PROCESSES * LIVES;
byte came; /* somebody came since process p looked whether it is alone: a bit each */
bit clean; /* the last one left by itself, and had been alone since it began to */

/* Makes a file: a number that nobody has. */
inline kernel_fresh(inode) {
  d_step {
    inode = 1;
    do
    :: inode < INODES ->
      used = inode == lock_name || inode == segment_name || inode == unfinished;
      for (q : 1 .. PROCESSES) { used = used || lock_file[q] == inode || mapped[q] == inode }
      if
      :: used -> inode++
      :: else -> break
      fi
    :: else -> assert(false) /* INODES is too small */
    od;
    gate[inode] = NONE;
    for (q : 0 .. PROCESSES) { BYTE(inode, q) = NONE }
    complete[inode] = 0;
    parts[inode] = 0;
    q = 0
  }
}

/* The kernel closes what a process has open, and its locks go. */
inline kernel_closes(p) {
  d_step {
    if
    :: lock_file[p] != NONE ->
      if
      :: gate[lock_file[p]] == p -> gate[lock_file[p]] = NONE
      :: else
      fi;
      for (q : 0 .. PROCESSES) {
        if
        :: BYTE(lock_file[p], q) == p -> BYTE(lock_file[p], q) = NONE
        :: else
        fi
      }
    :: else
    fi;
    lock_file[p] = NONE;
    mapped[p] = NONE;
    held[p] = 0;
    joined[p] = 0;
    q = 0
  }
}

/* Somebody else's lock on a participant's byte. */
inline look_for_others(p, found) {
  d_step {
    found = 0;
    for (q : 0 .. PROCESSES) {
      found = found || (BYTE(lock_file[p], q) != NONE && BYTE(lock_file[p], q) != p)
    }
    q = 0
  }
}

inline open_segment(p) {
  skip;
again:
  if
  :: atomic { lock_name != NONE -> lock_file[p] = lock_name } /* @ src/segment/segment.cpp open_private: const int fd = open_file(path, O_RDWR | O_NOFOLLOW | O_NONBLOCK) */
  :: lock_name == NONE -> /* @ src/segment/segment.cpp open_private: if (errno != ENOENT) refuse(path, "cannot open it", errno) */
    atomic {
      if
      :: lock_name == NONE -> kernel_fresh(file); lock_name = file /* @ src/segment/segment.cpp make_private: linkat(AT_FDCWD, */
      :: else /* @ src/segment/segment.cpp open_private: if (fd == -1 && (errno != EEXIST || (flags & O_EXCL) != 0)) */
      fi;
      file = NONE
    };
    goto again /* @ src/segment/segment.cpp open_private: if (fd != -1) ::close(fd) */
  fi;
#ifndef NO_GATE
  atomic { gate[lock_file[p]] == NONE -> gate[lock_file[p]] = p }; /* @ src/liveness/lock_file.cpp enter_gate: while (!try_lock(kGate)) */
#ifndef NO_INODE_CHECK
  if
  :: lock_name != lock_file[p] -> kernel_closes(p); goto again /* @ src/liveness/lock_file.cpp enter_gate: named.st_dev == device_ && named.st_ino == inode_ */
  :: else
  fi;
#endif
#endif
  if
  :: segment_name == NONE -> /* @ src/segment/segment.cpp examine: if (errno == ENOENT) return Fit::Absent */
#ifdef CREATE_THEN_FILL
    atomic { kernel_fresh(file); segment_name = file };
    complete[file] = 1;
    file = NONE
#else
#ifndef UNFINISHED_IS_USED
    unfinished = NONE; /* @ src/segment/segment.cpp create: ::unlink(unfinished.c_str()) */
    atomic { kernel_fresh(file); unfinished = file }; /* @ src/segment/segment.cpp create: Descriptor file(open_private(unfinished, trust, O_EXCL)) */
    complete[file] = 1; /* @ src/segment/segment.cpp create: if (pwrite(file.fd, &header, sizeof(header), 0) != sizeof(header)) */
    atomic { segment_name = unfinished; unfinished = NONE; file = NONE } /* @ src/segment/segment.cpp create: if (::rename(unfinished.c_str(), path.c_str()) == -1) */
#else
    if
    :: unfinished == NONE -> atomic { kernel_fresh(file); unfinished = file }; complete[file] = 1
    :: else
    fi;
    atomic { segment_name = unfinished; unfinished = NONE; file = NONE }
#endif
#endif
  :: else
  fi;
  atomic {
    mapped[p] = segment_name; /* @ src/segment/segment.cpp Segment: open_file(path, (writable ? O_RDWR : O_RDONLY) | O_NOFOLLOW */
    assert(mapped[p] != NONE);
    assert(complete[mapped[p]])
  };
  atomic {
    k = 1;
    do
    :: k <= PROCESSES && BYTE(lock_file[p], k) == NONE -> break /* @ src/transport/membership.cpp try_take_index: !lock_file_->try_lock(k) */
    :: k <= PROCESSES && BYTE(lock_file[p], k) != NONE -> k++
    od;
    BYTE(lock_file[p], k) = p;
    held[p] = k;
    k = 0
  };
  atomic {
    parts[mapped[p]] = parts[mapped[p]] | 1 << held[p]; /* @ src/transport/membership.cpp take_index: participant_state(index()).take() */
    joined[p] = 1;
    for (q : 1 .. PROCESSES) {
      assert(!joined[q] || mapped[q] == mapped[p]); /* all that use the name use one segment */
      assert(!joined[q] || q == p || held[q] != held[p])
    }
    q = 0
  };
#ifndef NO_GATE
  gate[lock_file[p]] = NONE /* @ src/transport/gate.cpp pass_gate: GateGuard gate(*file) */
#endif
}

inline remove_files(p) {
  atomic {
    for (q : 1 .. PROCESSES) { assert(!joined[q] || mapped[q] != segment_name || q == p) }
    q = 0;
    segment_name = NONE /* @ src/segment/segment.cpp remove: ::unlink(path.c_str()) */
  };
  unfinished = NONE; /* @ src/segment/segment.cpp remove: ::unlink(unfinished.c_str()) */
  lock_name = NONE /* @ src/transport/membership.cpp remove_files_if_last: ::unlink(lock_file_->path().c_str()) */
}

inline leave(p) {
  atomic { in_gate = 1; alone = (alive == 1); came = came & ~(1 << p) };
#ifndef NO_GATE
  atomic { gate[lock_file[p]] == NONE -> gate[lock_file[p]] = p }; /* @ src/transport/warden.cpp leave: in_gate = lock_file_.intact() && lock_file_.enter_gate(kGatePatience) */
#ifndef NO_INODE_CHECK
  if
  :: lock_name != lock_file[p] -> gate[lock_file[p]] = NONE; in_gate = 0 /* @ src/liveness/lock_file.cpp enter_gate: leave_gate(); return false */
  :: else
  fi;
#endif
#endif
  atomic {
    parts[mapped[p]] = parts[mapped[p]] & ~(1 << held[p]); /* @ src/transport/reaper.cpp reap_own: Recovery(world_).reap(index()) */
    joined[p] = 0
  };
  if
  :: in_gate ->
#ifdef UNLINK_WITHOUT_LOOK
    others = 0;
#else
    look_for_others(p, others); /* @ src/transport/membership.cpp remove_files_if_last: lock_file_->held_by_other(1, participants() - 1) */
#endif
    if
    :: !others -> remove_files(p)
    :: else
    fi;
#ifdef GATE_LEFT_FIRST
    gate[lock_file[p]] = NONE;
    BYTE(lock_file[p], held[p]) = NONE
#else
    BYTE(lock_file[p], held[p]) = NONE; /* @ src/transport/warden.cpp leave: lock_file_.unlock(index()) */
#ifndef NO_GATE
    gate[lock_file[p]] = NONE /* @ src/transport/warden.cpp leave: lock_file_.leave_gate() */
#endif
#endif
  :: else
  fi
}

proctype process(byte p) {
  byte lives = LIVES, file, k, q;
  bit used, in_gate, others, alone;
  do
  :: lives > 0 ->
    atomic {
      lives--;
      to_come--;
      alive++;
      dying[p] = 0;
      came = 255;
      clean = 0
    };
    {
      open_segment(p);
      leave(p);
      /* Left by itself; was there nobody else? */
      atomic {
        kernel_closes(p);
        clean = alone && !((came >> p) & 1);
        alone = 0;
        alive--;
        in_gate = 0;
        others = 0
      }
    } unless {
      d_step {
        dying[p] ->
        kernel_closes(p);
        dying[p] = 0;
        alive--;
        file = NONE; k = 0; in_gate = 0; others = 0; used = 0; alone = 0
      }
    }
  :: lives == 0 -> break
  od
}

/* Kills whoever it likes. */
proctype killer() {
  byte p;
  do
  :: atomic { kills > 0 && alive > 0 ->
      select (p : 1 .. PROCESSES);
      if
      :: lock_file[p] != NONE && !dying[p] -> dying[p] = 1; kills--
      :: else
      fi;
      p = 0 }
  :: atomic { to_come == 0 && alive == 0 -> break }
  :: kills == 0 -> break
  od
}

init {
  byte p;
  atomic {
    for (p : 1 .. PROCESSES) { run process(p) }
    run killer();
    p = 0
  };
  /* Everybody has gone: the last one by itself, or all of them. */
  atomic {
    (to_come == 0 && alive == 0) ->
    if
    :: clean || kills == KILLS -> assert(lock_name == NONE && segment_name == NONE && unfinished == NONE)
    :: else
    fi
  }
}
