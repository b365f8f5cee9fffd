// SPDX-License-Identifier: Apache-2.0
#include "litmus.hpp"

#include <cstdio>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "as_relacy.hpp"

/// The explorer's own tests: small programs whose outcomes are known. A name says what the outcome
/// of the program is: what each load has read, in the order of threads and steps.
namespace lot::weak {
namespace {

/// The words of a program, and what its loads have read.
class Board {
 public:
  Board() {
    for (auto* word : {&x, &y, &z}) word->store(0, rl::mo_relaxed, {"litmus", "litmus", 0});
  }
  rl::atomic<unsigned> x, y, z;
  unsigned r[8] = {};
};

using Word = rl::atomic<unsigned>;
const rl::debug_info kHere("litmus", "litmus", 0);

constexpr auto kRlx = rl::mo_relaxed;
constexpr auto kAcq = rl::mo_acquire;
constexpr auto kRel = rl::mo_release;
constexpr auto kAcqRel = rl::mo_acq_rel;
constexpr auto kSc = rl::mo_seq_cst;

unsigned get(Word& word, rl::memory_order order) { return word.load(order, kHere); }
void put(Word& word, unsigned value, rl::memory_order order) { word.store(value, order, kHere); }
unsigned swap(Word& word, unsigned value, rl::memory_order order) {
  return word.exchange(value, order, kHere);
}
unsigned add(Word& word, unsigned value, rl::memory_order order) {
  return word.fetch_add(value, order, kHere);
}
void fence(rl::memory_order order) { rl::atomic_thread_fence(order, kHere); }

struct Test {
  const char* name;
  std::vector<void (*)(Board&)> threads;
  /// What the program leaves, as text: r[0], r[1] ... so many of them, and then the words.
  unsigned loads;
  bool words;
  std::vector<const char*> allowed;    ///< must be seen
  std::vector<const char*> forbidden;  ///< must not be
};

const Test kTests[] = {
    // Store buffering: both look before either's store is seen.
    {"SB, relaxed",
     {[](Board& b) { put(b.x, 1, kRlx), b.r[0] = get(b.y, kRlx); },
      [](Board& b) { put(b.y, 1, kRlx), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"SB, release and acquire",
     {[](Board& b) { put(b.x, 1, kRel), b.r[0] = get(b.y, kAcq); },
      [](Board& b) { put(b.y, 1, kRel), b.r[1] = get(b.x, kAcq); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"SB, seq_cst",
     {[](Board& b) { put(b.x, 1, kSc), b.r[0] = get(b.y, kSc); },
      [](Board& b) { put(b.y, 1, kSc), b.r[1] = get(b.x, kSc); }},
     2,
     false,
     {"01", "10", "11"},
     {"00"}},
    {"SB, seq_cst stores and one acquire load",
     {[](Board& b) { put(b.x, 1, kSc), b.r[0] = get(b.y, kSc); },
      [](Board& b) { put(b.y, 1, kSc), b.r[1] = get(b.x, kAcq); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"SB, seq_cst fences",
     {[](Board& b) { put(b.x, 1, kRlx), fence(kSc), b.r[0] = get(b.y, kRlx); },
      [](Board& b) { put(b.y, 1, kRlx), fence(kSc), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"01", "10", "11"},
     {"00"}},
    {"SB, fences that are not seq_cst",
     {[](Board& b) { put(b.x, 1, kRlx), fence(kAcqRel), b.r[0] = get(b.y, kRlx); },
      [](Board& b) { put(b.y, 1, kRlx), fence(kAcqRel), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"SB, a seq_cst fence and seq_cst steps",
     {[](Board& b) { put(b.x, 1, kRlx), fence(kSc), b.r[0] = get(b.y, kRlx); },
      [](Board& b) { put(b.y, 1, kSc), b.r[1] = get(b.x, kSc); }},
     2,
     false,
     {"01", "10", "11"},
     {"00"}},
    // A read-modify-write is no fence.
    {"SB, acq_rel exchange and relaxed load",
     {[](Board& b) { swap(b.x, 1, kAcqRel), b.r[0] = get(b.y, kRlx); },
      [](Board& b) { swap(b.y, 1, kAcqRel), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"SB, seq_cst exchange and acquire load",
     {[](Board& b) { swap(b.x, 1, kSc), b.r[0] = get(b.y, kAcq); },
      [](Board& b) { swap(b.y, 1, kSc), b.r[1] = get(b.x, kAcq); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"SB, seq_cst exchange and seq_cst load",
     {[](Board& b) { swap(b.x, 1, kSc), b.r[0] = get(b.y, kSc); },
      [](Board& b) { swap(b.y, 1, kSc), b.r[1] = get(b.x, kSc); }},
     2,
     false,
     {"01", "10", "11"},
     {"00"}},
    {"SB, the second looks are read-modify-writes",
     {[](Board& b) { put(b.x, 1, kRlx), b.r[0] = add(b.y, 0, kAcqRel); },
      [](Board& b) { put(b.y, 1, kRlx), b.r[1] = add(b.x, 0, kAcqRel); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    // Message passing.
    {"MP, relaxed",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kRlx), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"MP, release and acquire",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 1, kRel); },
      [](Board& b) { b.r[0] = get(b.y, kAcq), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "11"},
     {"10"}},
    {"MP, fences",
     {[](Board& b) { put(b.x, 1, kRlx), fence(kRel), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kRlx), fence(kAcq), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "11"},
     {"10"}},
    {"MP, no acquire fence",
     {[](Board& b) { put(b.x, 1, kRlx), fence(kRel), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kRlx), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"10"},
     {}},
    {"MP, a store goes before an exchange",
     {[](Board& b) { swap(b.x, 1, kSc), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kAcq), b.r[1] = get(b.x, kSc); }},
     2,
     false,
     {"00", "01", "10", "11"},
     {}},
    {"MP, seq_cst",
     {[](Board& b) { swap(b.x, 1, kSc), put(b.y, 1, kSc); },
      [](Board& b) { b.r[0] = get(b.y, kSc), b.r[1] = get(b.x, kSc); }},
     2,
     false,
     {"00", "01", "11"},
     {"10"}},
    // Release sequences.
    {"MP, through a relaxed read-modify-write",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 1, kRel); }, [](Board& b) { add(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kAcq), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"21", "11", "10", "00"},
     {"20"}},
    {"MP, through a relaxed store of the same thread",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 1, kRel), put(b.y, 2, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kAcq), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"20", "21", "11"},
     {"10"}},
    // Coherence.
    {"CoRR",
     {[](Board& b) { put(b.x, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.x, kRlx), b.r[1] = get(b.x, kRlx); }},
     2,
     false,
     {"00", "01", "11"},
     {"10"}},
    {"CoRR, of two stores",
     {[](Board& b) { put(b.x, 1, kRlx); }, [](Board& b) { put(b.x, 2, kRlx); },
      [](Board& b) { b.r[0] = get(b.x, kRlx), b.r[1] = get(b.x, kRlx); },
      [](Board& b) { b.r[2] = get(b.x, kRlx), b.r[3] = get(b.x, kRlx); }},
     4,
     false,
     {"1212", "2121", "1112", "0012"},
     {"1221", "2112", "1020", "1010"}},
    {"CoWR",
     {[](Board& b) { put(b.x, 1, kRlx), b.r[0] = get(b.x, kRlx); },
      [](Board& b) { put(b.x, 2, kRlx); }},
     1,
     true,
     {"1 200", "1 100", "2 200"},
     {"0 100", "0 200", "2 100"}},
    {"CoRW",
     {[](Board& b) { b.r[0] = get(b.x, kRlx), put(b.x, 2, kRlx); },
      [](Board& b) { put(b.x, 1, kRlx); }},
     1,
     true,
     {"0 200", "0 100", "1 200"},
     {"1 100"}},
    {"exchanges stand in one row",
     {[](Board& b) { b.r[0] = add(b.x, 1, kRlx); }, [](Board& b) { b.r[1] = add(b.x, 1, kRlx); },
      [](Board& b) { b.r[2] = add(b.x, 1, kRlx); }},
     3,
     true,
     {"012 300", "210 300", "102 300"},
     {"000 100", "001 200", "011 200", "112 300"}},
    {"2+2W, relaxed",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 2, kRlx); },
      [](Board& b) { put(b.y, 1, kRlx), put(b.x, 2, kRlx); }},
     0,
     true,
     {" 110", " 120", " 210", " 220"},
     {}},
    {"2+2W, release",
     {[](Board& b) { put(b.x, 1, kRel), put(b.y, 2, kRel); },
      [](Board& b) { put(b.y, 1, kRel), put(b.x, 2, kRel); }},
     0,
     true,
     {" 110", " 120", " 210", " 220"},
     {}},
    {"2+2W, seq_cst",
     {[](Board& b) { put(b.x, 1, kSc), put(b.y, 2, kSc); },
      [](Board& b) { put(b.y, 1, kSc), put(b.x, 2, kSc); }},
     0,
     true,
     {" 120", " 210", " 220"},
     {" 110"}},
    {"2+2W, exchanges",
     {[](Board& b) { swap(b.x, 1, kAcqRel), swap(b.y, 2, kAcqRel); },
      [](Board& b) { swap(b.y, 1, kAcqRel), swap(b.x, 2, kAcqRel); }},
     0,
     true,
     {" 120", " 210", " 220"},
     {}},
    {"S, relaxed",
     {[](Board& b) { put(b.x, 2, kRlx), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.y, kRlx), put(b.x, 1, kRlx); }},
     1,
     true,
     {"1 210", "1 110"},
     {}},
    {"S, release and acquire",
     {[](Board& b) { put(b.x, 2, kRlx), put(b.y, 1, kRel); },
      [](Board& b) { b.r[0] = get(b.y, kAcq), put(b.x, 1, kRlx); }},
     1,
     true,
     {"1 110", "0 210", "0 110"},
     {"1 210"}},
    {"R, seq_cst store and load",
     {[](Board& b) { put(b.x, 1, kSc), put(b.y, 1, kSc); },
      [](Board& b) { put(b.y, 2, kSc), b.r[0] = get(b.x, kSc); }},
     1,
     true,
     {"0 110", "1 120"},
     {"0 120"}},
    // More threads.
    {"IRIW, acquire",
     {[](Board& b) { put(b.x, 1, kRel); }, [](Board& b) { put(b.y, 1, kRel); },
      [](Board& b) { b.r[0] = get(b.x, kAcq), b.r[1] = get(b.y, kAcq); },
      [](Board& b) { b.r[2] = get(b.y, kAcq), b.r[3] = get(b.x, kAcq); }},
     4,
     false,
     {"1010", "1111", "0000"},
     {}},
    {"IRIW, seq_cst",
     {[](Board& b) { put(b.x, 1, kSc); }, [](Board& b) { put(b.y, 1, kSc); },
      [](Board& b) { b.r[0] = get(b.x, kSc), b.r[1] = get(b.y, kSc); },
      [](Board& b) { b.r[2] = get(b.y, kSc), b.r[3] = get(b.x, kSc); }},
     4,
     false,
     {"1011", "1110", "1111", "0000"},
     {"1010"}},
    {"IRIW, seq_cst fences",
     {[](Board& b) { put(b.x, 1, kRlx); }, [](Board& b) { put(b.y, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.x, kRlx), fence(kSc), b.r[1] = get(b.y, kRlx); },
      [](Board& b) { b.r[2] = get(b.y, kRlx), fence(kSc), b.r[3] = get(b.x, kRlx); }},
     4,
     false,
     {"1011", "1110", "1111", "0000"},
     {"1010"}},
    {"WRC, release and acquire",
     {[](Board& b) { put(b.x, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.x, kAcq), put(b.y, 1, kRel); },
      [](Board& b) { b.r[1] = get(b.y, kAcq), b.r[2] = get(b.x, kRlx); }},
     3,
     false,
     {"111", "010", "100"},
     {"110"}},
    {"WRC, relaxed",
     {[](Board& b) { put(b.x, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.x, kRlx), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[1] = get(b.y, kRlx), b.r[2] = get(b.x, kRlx); }},
     3,
     false,
     {"111", "110"},
     {}},
    {"ISA2, release and acquire",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 1, kRel); },
      [](Board& b) { b.r[0] = get(b.y, kAcq), put(b.z, 1, kRel); },
      [](Board& b) { b.r[1] = get(b.z, kAcq), b.r[2] = get(b.x, kRlx); }},
     3,
     false,
     {"111", "010", "100", "101"},
     {"110"}},
    {"ISA2, relaxed in the middle",
     {[](Board& b) { put(b.x, 1, kRlx), put(b.y, 1, kRel); },
      [](Board& b) { b.r[0] = get(b.y, kRlx), put(b.z, 1, kRel); },
      [](Board& b) { b.r[1] = get(b.z, kAcq), b.r[2] = get(b.x, kRlx); }},
     3,
     false,
     {"111", "110"},
     {}},
    // A seq_cst step may be ordered before one that was done earlier: only what is strongly before
    // it counts. C++11 forbade the first of these; Power showed that it must not.
    {"Z6.U",
     {[](Board& b) { put(b.x, 1, kSc), put(b.y, 1, kRel); },
      [](Board& b) { b.r[0] = add(b.y, 1, kSc), b.r[1] = get(b.y, kRlx); },
      [](Board& b) { put(b.y, 3, kSc), b.r[2] = get(b.x, kSc); }},
     3,
     false,
     {"130"},
     {}},
    {"a chain behind a store that goes before an exchange",
     {[](Board& b) { swap(b.x, 1, kSc), put(b.z, 1, kRlx); },
      [](Board& b) { b.r[0] = get(b.z, kRlx), add(b.y, 1, kSc); },
      [](Board& b) { b.r[1] = get(b.y, kSc), b.r[2] = get(b.x, kSc); }},
     3,
     false,
     {"110", "111"},
     {}},
    {"the same with release and acquire",
     {[](Board& b) { swap(b.x, 1, kSc), put(b.z, 1, kRel); },
      [](Board& b) { b.r[0] = get(b.z, kAcq), add(b.y, 1, kSc); },
      [](Board& b) { b.r[1] = get(b.y, kSc), b.r[2] = get(b.x, kSc); }},
     3,
     false,
     {"111"},
     {"110"}},
    // What the explorer does not show, though C++20 allows it: a load that reads what is stored
    // later. It stands here so that the page that says so cannot be wrong.
    {"LB, relaxed (not shown)",
     {[](Board& b) { b.r[0] = get(b.x, kRlx), put(b.y, 1, kRlx); },
      [](Board& b) { b.r[1] = get(b.y, kRlx), put(b.x, 1, kRlx); }},
     2,
     false,
     {"00", "01", "10"},
     {"11"}},
    {"membarrier, against a store and a load that only the compiler orders",
     {[](Board& b) { put(b.x, 1, kRlx), b.r[0] = get(b.y, kRlx); },
      [](Board& b) {
        put(b.y, 1, kRlx), rl::explorer().process_barrier(), b.r[1] = get(b.x, kRlx);
      }},
     2,
     false,
     {"01", "10", "11"},
     {"00"}},
};

std::string outcome_of(const Test& test, Board& board) {
  std::string text;
  for (unsigned i = 0; i < test.loads; ++i) text += std::to_string(board.r[i]);
  if (!test.words) return text;
  text += ' ';
  for (auto* word : {&board.x, &board.y, &board.z}) text += std::to_string(get(*word, kRlx));
  return text;
}

std::set<std::string> outcomes_of(const Test& test, std::uint64_t& executions) {
  std::set<std::string> seen;
  std::unique_ptr<Board> board;
  const Suite suite{static_cast<unsigned>(test.threads.size()),
                    [] {},
                    [] {},
                    [&] { board = std::make_unique<Board>(); },
                    [&](unsigned t) { test.threads[t](*board); },
                    [&] {
                      seen.insert(outcome_of(test, *board));
                      board.reset();
                    }};
  Bounded all(~0U);
  Explorer explorer(suite, all, {});
  executions += explorer.run().executions;
  return seen;
}

bool is_right(const Test& test, std::uint64_t& executions) {
  const auto seen = outcomes_of(test, executions);
  std::string wrong;
  for (const char* outcome : test.allowed) {
    if (seen.count(outcome) == 0) wrong += std::string("\n    not seen: ") + outcome;
  }
  for (const char* outcome : test.forbidden) {
    if (seen.count(outcome) != 0) wrong += std::string("\n    seen, and forbidden: ") + outcome;
  }
  if (wrong.empty()) return true;
  std::printf("%s: WRONG%s\n    seen:", test.name, wrong.c_str());
  for (const auto& outcome : seen) std::printf(" %s", outcome.c_str());
  std::printf("\n");
  return false;
}

}  // namespace

unsigned run_litmus_tests(bool stops) {
  unsigned wrong = 0;
  std::uint64_t executions = 0;
  for (const Test& test : kTests) {
    wrong += is_right(test, executions) ? 0 : 1;
    if (stops && wrong != 0) break;
  }
  std::printf("total: %zu litmus tests, %u wrong, %llu executions\n", std::size(kTests), wrong,
              static_cast<unsigned long long>(executions));
  return wrong;
}

}  // namespace lot::weak
