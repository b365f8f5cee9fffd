# SPDX-License-Identifier: Apache-2.0
"""Mistakes in the steps of recovery, sleep, death, memory that goes back and selection, each planted
in a copy of the headers."""

import dataclasses
import pathlib
import shutil
import subprocess
import tempfile

RECOVERY = 'src/recovery/recovery.hpp'
OWNERSHIP = 'src/refcount/ownership.hpp'
SLEEP = 'src/lockfree_ring/sleep.hpp'
CLAIMS = 'src/lockfree_ring/claims.hpp'
UNITS = 'src/segment/units.hpp'
LOCK = 'src/robust_mutex/lock_word.hpp'
BOUNDS = 'src/selection/bounds.hpp'
SELECTOR = 'src/selection/selector.hpp'


@dataclasses.dataclass(frozen=True)
class Planted:
    name: str
    file: str
    unit: str     # the scenarios that are to notice: tests/proof/model/UNIT_model.cpp
    pairs: tuple  # (text, text instead), each found exactly once


MISTAKES = (
    Planted('a conditional wake in the reaper', RECOVERY, 'crash', ((
        '''    r.clear_sleepers();
    r.wake_sleepers([this](auto& word) { world_.wake(word); });''',
        '''    for (std::uint32_t i = 0; i < r.depth; ++i) {
      if (ring::clear_sleeper(r.slots[i])) world_.wake(r.slots[i]);
    }'''),)),
    Planted('the ring loses its name before the work', RECOVERY, 'crash', ((
        'writer.end(generation, k);', 'writer.end(generation, refcount::kOrphanage);'),)),
    Planted('the participant loses its name before the work', RECOVERY, 'crash', ((
        '    wake_whom_it_announced_to(k);\n    for',
        '    world_.participant_state(k).free();\n'
        '    wake_whom_it_announced_to(k);\n    for'),)),
    Planted('a half-done ring is taken for done', RECOVERY, 'crash', ((
        'if (ring::writer_owner(w) != k || ring::writer_state(w) == ring::State::Free) return;',
        'if (ring::writer_owner(w) != k || ring::writer_state(w) == ring::State::Free ||\n'
        '        ring::writer_state(w) == ring::State::Orphan) return;'),)),
    Planted('an unfinished ring is left as an orphan', RECOVERY, 'crash', ((
        '    if (ring::writer_state(w) == ring::State::Init) {', '    if (false) {'),)),
    Planted('a cell loses its name before its cursor', RECOVERY, 'crash', ((
        '      if (!make_idle(r, i, k)) continue;\n',
        '      r.who[i].store(0, std::memory_order_release);\n'
        '      r.cells[i].position.store(ring::kIdle, std::memory_order_release);\n'),)),
    Planted('a living joiner\'s place is taken out of the cell', RECOVERY, 'crash', ((
        '      if (r.who[i].load(std::memory_order_relaxed) != k + 1) return false;  // R14\n', ''),)),
    Planted('a place is taken out of the cell, whosever it is by now', RECOVERY, 'crash', ((
        '      if (word.compare_exchange_strong(position, ring::kIdle, std::memory_order_release,\n'
        '                                       std::memory_order_relaxed)) {  // R3\n'
        '        return true;\n      }\n',
        '      word.store(ring::kIdle, std::memory_order_release);\n      return true;\n'),)),
    Planted('a place that the sender gives a dead joiner meanwhile stays in the cell', RECOVERY, 'crash', ((
        '                                       std::memory_order_relaxed)) {  // R3\n'
        '        return true;\n      }\n',
        '                                       std::memory_order_relaxed)) {  // R3\n'
        '      }\n      return true;\n'),)),
    Planted('a living joiner\'s cell is set free', RECOVERY, 'crash', ((
        '      r.who[i].compare_exchange_strong(dead, 0, std::memory_order_release,\n'
        '                                       std::memory_order_relaxed);  // R3, R8\n',
        '      r.who[i].store(dead - dead, std::memory_order_release);\n'),)),
    Planted('a dead reader does not make the sender look', RECOVERY, 'crash', ((
        '      r.space->fetch_add(2, std::memory_order_release);  // R6\n', ''),)),
    Planted('the sender is not woken for a dead reader', RECOVERY, 'crash', ((
        '      world_.wake(*r.space);\n', ''),)),
    Planted('whom a dead publisher announced itself to sleeps on', RECOVERY, 'sleep', ((
        '    wake_whom_it_announced_to(k);\n    for', '    for'),)),
    Planted('who is just falling asleep does not hear of a dead one\'s ring', RECOVERY, 'sleep', ((
        '      wake_readers(r);\n    }\n  }\n',
        '      r.wake_sleepers([this](auto& word) { world_.wake(word); });\n    }\n  }\n'),)),
    Planted('no look at the readers\' places when adopting', RECOVERY, 'orphan', ((
        '      if (position != ring::kIdle) adopt(ring::block(position));\n', ''),)),
    Planted('references are not adopted', RECOVERY, 'orphan', ((
        '    adopt_references(k);\n    // All', '    // All'),)),
    Planted('own bits are cleared before the orphanage adopts', RECOVERY, 'orphan', (
        ('    for (std::uint32_t b = 0; b < world_.blocks(); ++b) Own::let_go(world_.block(b), k);\n', ''),
        ('    wake_whom_it_announced_to(k);\n    for',
         '    for (std::uint32_t b = 0; b < world_.blocks(); ++b) Own::let_go(world_.block(b), k);\n'
         '    wake_whom_it_announced_to(k);\n    for'))),
    Planted('holds go while a home still has the dead one\'s name', RECOVERY, 'orphan', ((
        '++b) move_home(b, k);\n    for (std::uint32_t b = 0; b < world_.blocks(); ++b) Own::let_go(world_.block(b), k);',
        '++b) {\n      Own::let_go(world_.block(b), k);\n      move_home(b, k);\n    }'),)),
    Planted('adopting does not bump the version', OWNERSHIP, 'orphan', ((
        '    b.life.fetch_add(kVersion, std::memory_order_release);  // O2: adopting is a hand-over too\n',
        ''),)),
    Planted('a counter for the orphanage\'s bit', OWNERSHIP, 'crash', ((
        'b.own[0].fetch_or(1, std::memory_order_relaxed);',
        'b.own[0].fetch_add(1, std::memory_order_relaxed);'),)),
    Planted('a block is free before its memory', RECOVERY, 'crash', (
        ('    world_.release_extents(dead);\n', ''),
        ('    if (!released) return false;\n',
         '    world_.release_extents(dead);\n    if (!released) return false;\n'))),
    Planted('a reap does not collect', RECOVERY, 'crash', ((
        '    collect();\n    world_.part', '    world_.part'),)),
    Planted('what is still borrowed is not needed', RECOVERY, 'orphan', ((
        '        if (position != ring::kIdle) need(ring::block(position));\n', ''),)),
    Planted('what orphans refer to is not needed', RECOVERY, 'orphan', ((
        '        world_.each_reference(b, need);\n', ''),)),
    Planted('rings are recycled without the lock', RECOVERY, 'crash', (
        ('    if (!world_.lock_rings()) return false;\n', ''),
        ('    world_.unlock_rings();\n', ''))),
    Planted('re-check: deserted, under the lock', RECOVERY, 'crash', ((
        '      if (!is_deserted_orphan(c)) continue;\n', '''      const auto state = ring::writer_state(
          world_.channel_writer(c).load(std::memory_order_relaxed));
      if (state != ring::State::Orphan) continue;
'''),)),
    Planted('re-check: room, after the mark', SLEEP, 'ring', ((
        '  if (room()) return std::nullopt;', '  if (false) return std::nullopt;'),)),
    Planted('re-check: the end, after the mark', SLEEP, 'sleep', ((
        'source.reader.is_closing() || source.reader.has_returns()', 'source.reader.has_returns()'),)),
    Planted('a mark is taken away and begins no new round', 'src/lockfree_ring/ring.hpp', 'sleep', ((
        'marked ? next_round(seen) : seen', 'seen & ~kSleeper'),)),
    Planted('a conditional wake in the announcement', SLEEP, 'sleep', ((
        '    if (clear_sleeper(ring.slots[i])) wake(ring.slots[i]);\n',
        '    if ((ring.slots[i].load(std::memory_order_relaxed) & kSleeper) != 0) {\n'
        '        clear_sleeper(ring.slots[i]);\n      }\n'),)),
    Planted('a message is taken twice', CLAIMS, 'taken', ((
        '  while (sequence(seen) == of_sequence && block(seen) != kNoBlock) {',
        '  while (sequence(seen) == of_sequence) {'),)),
    Planted('a dead worker\'s claims stay', RECOVERY, 'task', ((
        '++c) take_claims_back(c, k);', '++c) (void)c;'),)),
    Planted('who sleeps does not hear of a dead one\'s task', RECOVERY, 'task', ((
        'r.take_claims_back(k)) wake_readers(r);', 'r.take_claims_back(k)) return;'),)),
    Planted('readers that have passed a task do not look again', 'src/lockfree_ring/ring.hpp', 'task', ((
        '    start_at_newest(kFromTheStart);\n  }\n  std::uint32_t unclaimed', '  }\n  std::uint32_t unclaimed'),)),
    Planted('what was taken back is not told', 'src/lockfree_ring/ring.hpp', 'task', ((
        '    unclaim(claims[i], claim);\n    returned->fetch_add(1, std::memory_order_release);  // C2\n',
        '    unclaim(claims[i], claim);\n'),)),
    Planted('re-check: returns, after the mark', SLEEP, 'task', ((
        'source.reader.is_closing() || source.reader.has_returns()', 'source.reader.is_closing()'),)),
    Planted('re-check: the message, after the claim', 'src/lockfree_ring/ring.hpp', 'task', ((
        '    if (sequence(seen) == cursor_ && block(seen) != kNoBlock) return mine;\n    unclaim(word, mine);\n    return 0;\n',
        '    (void)seen;\n    return mine;\n'),)),
    Planted('a late worker claims what is newer', CLAIMS, 'task', ((
        '    if (ahead > 0 || (ahead == 0 && claim_worker(seen) != 0)) return 0;',
        '    if (ahead == 0 && claim_worker(seen) != 0) return 0;'),)),
    Planted('what somebody works on is claimed', CLAIMS, 'task', ((
        '    if (ahead > 0 || (ahead == 0 && claim_worker(seen) != 0)) return 0;',
        '    if (ahead > 0) return 0;'),)),
    Planted('who sleeps beside a task hears of no new ring', SLEEP, 'task', ((
        '  if (now != version || !any_live) sleep_on(directory.word(), now, false);',
        '  if (now != version || sources.empty()) sleep_on(directory.word(), now, false);'),)),
    Planted('a reader of the ring is not told after the dead one', 'src/lockfree_ring/ring.hpp', 'task', ((
        '    if (reads) returned->fetch_add(1, std::memory_order_release);  // C2\n', ''),)),
    Planted('a ring with items is deserted', 'src/lockfree_ring/ring.hpp', 'task', ((
        '    return (!awaits && !taken) || !has_news();', '    return !awaits || !has_news();'),)),
    Planted('who waits for a task leaves when the publisher goes', 'src/lockfree_ring/ring.hpp', 'task', ((
        '  bool is_closing() const { return orphaned() && !is_unfinished(); }',
        '  bool is_closing() const { return orphaned(); }'),)),
    Planted('what was taken is given up before what is older', 'src/lockfree_ring/ring.hpp', 'taken', ((
        '        if (block(ring_.slots[oldest_].load(std::memory_order_seq_cst)) != kNoBlock) return;  // R10\n',
        ''),)),
    Planted('re-check: the roster, behind the floor', 'src/lockfree_ring/ring.hpp', 'ring', ((
        '    refresh_roster();\n    if (!minimum_known_) find_slowest();\n'
        '    return distance(message, minimum_) < 0;\n', '    return true;\n'),)),
    Planted('the sender gives a joiner a place before the floor', 'src/lockfree_ring/ring.hpp', 'ring', ((
        'sequence(position), floor_, ring_.guarded());',
        'sequence(position), ring_.first, ring_.guarded());'),)),
    Planted('a joiner looks anew whether the ring was full', 'src/lockfree_ring/ring.hpp', 'ring', ((
        '    const std::uint64_t published = ring_.published(head, word);\n',
        '    const std::uint64_t published =\n'
        '        ring_.published(head, ring_.slots[places_ - 1].load(std::memory_order_relaxed));\n'),)),
    Planted('a lossless publisher waits for an observer', 'src/lockfree_ring/ring.hpp', 'ring', ((
        '      if (position == kIdle || is_observer(position)) continue;\n      if (distance(sequence',
        '      if (position == kIdle) continue;\n      if (distance(sequence'),)),
    Planted('a lossless publisher uses the block again that an observer looks at', 'src/lockfree_ring/ring.hpp', 'ring', ((
        '    return observers_ != 0;\n', '    return false;\n'),)),
    Planted('an observer does not say what it looks at', 'src/lockfree_ring/ring.hpp', 'ring', ((
        'reader.guarded_ = ring.guarded() || observes;', 'reader.guarded_ = ring.guarded();'),)),
    Planted('an observer is a reader behind its first message', 'src/lockfree_ring/ring.hpp', 'ring', ((
        '    ring_.cells[cell_].position.store(make(cursor_, kNoBlock) | mark_,\n'
        '                                      std::memory_order_release);  // R3\n    if',
        '    ring_.cells[cell_].position.store(make(cursor_, kNoBlock),\n'
        '                                      std::memory_order_release);  // R3\n    if'),)),
    Planted('an observer that finds nothing is a reader', 'src/lockfree_ring/ring.hpp', 'ring', ((
        '      position.store(make(cursor_, kNoBlock) | mark_,\n', '      position.store(make(cursor_, kNoBlock),\n'),)),
    Planted('a woken locker does not say that others sleep', LOCK, 'lock', ((
        'has_slept ? name | kSleepers : name', 'name'),)),
    Planted('the first who sleeps for a lock does not say so', LOCK, 'lock', ((
        '        seen |= kSleepers;', '        return seen;'),)),
    Planted('a lock is taken over from who has it now', LOCK, 'lock', ((
        '    return word_.compare_exchange_strong(seen, name | kSleepers,',
        '    seen = word_.load(std::memory_order_acquire);\n'
        '    return word_.compare_exchange_strong(seen, name | kSleepers,'),)),
    Planted('a lock that somebody sleeps for stays locked', LOCK, 'lock', ((
        '    return seen == (name | kSleepers) &&', '    return seen == name &&'),)),
    Planted('nobody is told on the condition of a ring', 'src/lockfree_ring/ring.hpp', 'mutex', ((
        '    if (arrived != nullptr) return RobustCondition(*arrived).renew();\n', ''),)),
    Planted('a mark on the condition is kept', 'src/robust_mutex/robust_condition.hpp', 'mutex', ((
        '    word_.fetch_add(kWaits, std::memory_order_relaxed);  // takes',
        '    word_.fetch_add(0, std::memory_order_relaxed);  // takes'),)),
    Planted('a bell is lost when somebody leaves meanwhile', 'src/lockfree_ring/ring.hpp', 'taken', ((
        '    while ((v & 1) != 0) {\n      if (space.compare_exchange_weak(v, v + 1',
        '    if ((v & 1) != 0) {\n      if (space.compare_exchange_weak(v, v + 1'),)),
    Planted('re-check: at home, before a reclaim', OWNERSHIP, 'ownership', ((
        '      if ((v & hold::kHome) == 0) return false;\n', ''),)),
    Planted('re-check: the version, at the death', OWNERSHIP, 'ownership', ((
        '    return (holders & ~kWanted) == 0 &&\n',
        '''    life = b.life.load(std::memory_order_relaxed);
    return (holders & ~kWanted) == 0 &&\n'''),)),
    Planted('what a ring takes stays unseen', OWNERSHIP, 'ownership', ((
        'amount == hold::kRing ? v & ~hold::kUnseen : v;', 'v;'),)),
    Planted('what a weak pointer looks after stays unseen', OWNERSHIP, 'ownership', ((
        '(hold::kUnseen | hold::kBusy)) == hold::kUnseen &&',
        '(hold::kUnseen | hold::kBusy)) == hold::kHolds &&'),)),
    Planted('memory goes back without being claimed', UNITS, 'granules', (
        ('    if (!granules.extend(first, run, tag)) return false;\n', '    (void)tag;\n'),
        ('    granules.put_back(first, run);\n', ''))),
    Planted('what an attempt has got is forgotten', UNITS, 'granules', ((
        '    const bool given = ask(unit);\n    note_attempt(unit);\n',
        '    const bool given = ask(unit);\n'),)),
    Planted('a unit is none, whoever has asked for it meanwhile', UNITS, 'granules', ((
        '        words_[unit].compare_exchange_strong(leaving, kNone, std::memory_order_relaxed,\n'
        '                                             std::memory_order_relaxed);\n',
        '        words_[unit].store(leaving - leaving, std::memory_order_relaxed);\n'),)),
    Planted('a joiner keeps the round of the cell\'s former reader', BOUNDS, 'selection', ((
        'bound_round(from.load(std::memory_order_relaxed)) + 1;',
        'bound_round(from.load(std::memory_order_relaxed));'),)),
    Planted('a reader is selected again that has yet to read its own', SELECTOR, 'selection', ((
        '    if (is_set(end) && precedes(ring::sequence(position), end)) return std::nullopt;\n', ''),)),
    Planted('a reader is selected before it has a place', SELECTOR, 'selection', ((
        '    if (!ring::is_place(position)) return std::nullopt;\n', ''),)),
    Planted('an observer is selected', SELECTOR, 'selection', ((
        '    if (ring::is_observer(position)) return std::nullopt;  // it begins none\n', ''),)),
    Planted('an observer is taken for the reader that had its cell', SELECTOR, 'selection', ((
        ' && !ring::is_observer(position)', ''),)),
    Planted('the cell is not looked at again when its round is known', SELECTOR, 'selection', ((
        ' || ring_.who[*cell].load(std::memory_order_relaxed) != participant + 1', ''),)),
)


def changed(mutant, text):
    """The text of the mutant's file with the mistake in it."""
    for old, new in mutant.pairs:
        if text.count(old) != 1:
            raise ValueError(f'{mutant.name}: not once in {mutant.file}: {old.strip()}')
        text = text.replace(old, new)
    return text


def misplaced(root):
    """The mistakes that the sources have no place for, with the reason."""
    reasons = []
    for mutant in MISTAKES:
        try:
            changed(mutant, (root / mutant.file).read_text())
        except ValueError as reason:
            reasons.append(str(reason))
    return reasons


class Builds:
    """Builds the model against copies of the headers; each is gone when it has been tried out."""

    COPIED = ('lockfree_ring', 'refcount', 'recovery', 'robust_mutex', 'segment', 'selection')

    AS_BUILT = ('main', 'plant', 'simulate')  # they see none of the headers

    def __init__(self, root, compiler, built):
        self.root = root
        self.compiler = compiler
        self.built = built  # where lot_model was built, with Relacy as its CMakeLists.txt has mended it

    def try_out(self, mutant, hint, try_model):
        with tempfile.TemporaryDirectory(prefix='lot_mutant_') as scratch:
            source = pathlib.Path(scratch) / 'src'
            for room in self.COPIED:
                shutil.copytree(self.root / 'src' / room, source / room)
            file = pathlib.Path(scratch) / mutant.file
            file.write_text(changed(mutant, file.read_text()))
            return try_model(self.build(mutant, source), [], hint)

    def build(self, mutant, source):
        model = self.root / 'tests' / 'proof' / 'model'
        program = source.parent / 'model'
        units = ('world', 'subscription', mutant.unit + '_model')
        subprocess.run(
            [self.compiler, '-std=c++20', '-O1', '-w', '-I', source, '-I', self.root / 'src', '-I',
             self.root / 'include', '-I', self.root / 'tests', '-isystem', self.built / 'include',
             *(model / f'{unit}.cpp' for unit in units),
             *(self.built / 'CMakeFiles' / 'lot_model.dir' / f'{unit}.cpp.o' for unit in self.AS_BUILT),
             '-o', program], check=True, timeout=1800)
        return program
