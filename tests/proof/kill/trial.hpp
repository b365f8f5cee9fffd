// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "node.hpp"
#include "segment/segment.hpp"
#include "shadow.hpp"
#include "tracee.hpp"

namespace lot::kill {

/// A forked process that does what it is told, one order at a time.
class Actor {
 public:
  /// `name`: what the segment calls it.
  Actor(const Operation& operation, const EngineOptions& options, std::uint64_t source,
        std::string name);
  ~Actor();
  Actor(const Actor&) = delete;
  Actor& operator=(const Actor&) = delete;

  enum class Order : std::uint32_t {
    Act,      ///< the scene's act of that number
    Operate,  ///< the operation itself, between the marks
    Contend,  ///< a pop, or a pull, behind the first mark
    WhenAsleep,
    Arm,      ///< prepares what the probes need
    Ready,    ///< prepares what the probe of that number needs
    Probe,    ///< the probe of that number, between the marks
    Inspect,  ///< reads and publishes all it can, looks at what it holds
    NewLife,  ///< what a node does that was started again
    Meet,     ///< asks what topics carry, and receives what the new life published
    Start,    ///< joins, publishes to itself: works after everybody has died
    Drop,     ///< drops all but the engine
    Leave
  };
  struct Reply {
    bool ok;
    std::uint32_t index;    ///< of the participant; 0: none
    std::uint64_t last[8];  ///< by source: number of the last message + 1
    std::uint64_t missed;   ///< messages of all sources that it was told it missed
    bool reads_topic;
    bool reads_frames;
    std::uint64_t frames;
    bool reads_items;
    std::uint64_t items;  ///< bits of those that it has popped
    std::uint64_t put;    ///< how many it has put
    bool probe_ready;     ///< the scene has what the probe needs
    char complaint[200];
  };
  void tell(Order order, std::uint32_t number = 0);
  /// Nothing: it hangs, or has ended.
  std::optional<Reply> answer(unsigned seconds = 30);

  pid_t pid() const { return pid_; }
  void send(int signal) const;
  /// Stops it; from then on it stands still.
  void stop();
  /// The tracer has killed it and waited for it.
  void was_killed() { pid_ = -1; }
  void kill();
  /// Where it stands, for people.
  std::string whereabouts() const;

 private:
  [[noreturn]] void serve(const Operation& operation, Node& node);
  static void obey(Order order, std::uint32_t number, const Operation& operation, Node& node);

  pid_t pid_ = -1;
  int orders_[2];
  int replies_[2];
};

/// One run of an operation in its scene, up to a point.
class Trial {
 public:
  /// `probes`: the witness will be asked to probe().
  Trial(const Operation& operation, std::string segment, bool probes);
  ~Trial();
  Trial(const Trial&) = delete;
  Trial& operator=(const Trial&) = delete;

  /// A step that other processes may see. The steps between two stations are seen by none.
  struct Station {
    Tracee::Station at;
    bool changes;  ///< a byte of the segment
  };
  using Path = std::vector<Station>;

  struct Walk {
    std::uint64_t instructions = 0;  ///< on a path: of its stations only
    std::uint64_t points = 0;        ///< instructions after which something had changed
    std::uint64_t calls = 0;         ///< system calls
    bool finished = false;           ///< the operation came to its end
    bool strayed = false;  ///< from the path: nothing can be said, another trial must step
    Path path;             ///< that it went
  };
  /// Steps the victim until `points` changes were seen, or to the end of its operation. Where there
  /// is a path it runs from station to station, and steps over those only.
  Walk walk(std::uint64_t points, const Path* path = nullptr);

  struct Asked {
    std::uint32_t probe;
    bool stepped;  ///< and its instructions are counted
  };
  /// What one probe took while the victim stood still.
  struct Probed {
    bool ran = false;
    bool waited = false;
    std::uint64_t instructions = 0;  ///< 0: not counted
  };
  /// Operations of the neighbour while the victim stands still. None that is called wait-free or
  /// lock-free may wait, or take more instructions than its bound.
  std::vector<Probed> probe(const std::vector<Asked>& which);
  static std::uint64_t bound_of(Promise promise);

  /// Kills the victim and looks whether all promises hold. Returns the violations.
  std::vector<std::string> kill_and_inspect();

  /// What became of an operation one of whose system calls failed.
  struct Failure {
    std::optional<long> call;  ///< its number
    bool spared = false;       ///< it was not one that can fail so
    bool strayed = false;      ///< from the path: nothing can be said, another trial must step
    std::string error;         ///< what the operation threw; empty: it got through
    std::vector<std::string> violations;
  };
  /// Runs the operation with one system call failing, lets the victim leave, and looks whether all
  /// promises hold.
  Failure fail_call(std::uint64_t nth, int error, const Path* path = nullptr);

  static constexpr std::uint64_t kMost = ~std::uint64_t{0};

 private:
  void set_up();
  void clean_up();
  void stop_rival();
  bool rival_holds(segment::Segment& segment, const std::vector<std::uint64_t>& lives) const;
  bool rival_has_copied(segment::Segment& segment, const Number& message) const;
  void let_rival_go_on();
  void begin();
  std::optional<Tracee::Step> next(const Path* path, std::size_t done, bool helped);
  void let_go_on() const;
  void help_sleeper();
  bool has_ended();
  bool is_registry_free() const;
  Probed step(Tracee& neighbour, const Probe& probe);
  void inspect();
  Actor::Reply must_answer(Actor& actor, const char* what);
  std::uint64_t published_on(const char* topic) const;
  std::uint64_t overwritten_on(const char* topic) const;
  void look_at_reader(const Actor::Reply& seen, const char* reader);
  std::uint64_t untaken() const;
  void note_published();
  void inspect_with_witness();
  void inspect_with_bystander();
  void inspect_alone();
  void violation(const std::string& what);
  std::size_t files() const;

  const Operation& operation_;
  EngineOptions options_;
  std::optional<Actor> witness_;
  std::optional<Actor> bystander_;
  std::optional<Actor> dead_;
  std::optional<Actor> rival_;
  std::optional<Actor> victim_;
  std::optional<Tracee> traced_;
  std::optional<Tracee> stopped_;  ///< the rival
  std::optional<Shadow> shadow_;
  std::vector<std::string> violations_;
  /// What the rings said while they stood still: those that are closed may be gone later.
  std::uint64_t published_ = 0, frames_ = 0;
  std::uint64_t may_miss_ = 0;  ///< of the topic's messages: they were overwritten
  std::uint64_t untaken_ = 0;   ///< items that were in the queue at the end: the witness's
  /// Where a call of the victim failed, others go on before it has answered: what they may have
  /// got.
  std::uint64_t may_come_early_ = 0;
  std::uint64_t popped_ = 0;  ///< items that the witness had got before
  std::uint64_t put_ = 0;     ///< how many it had put before
  std::uint32_t rival_index_ = 0;
  bool rival_reads_ = false;  ///< it reads the topic, and takes no item
  std::uint64_t rivals_ = 0;  ///< items that the rival has got
};

}  // namespace lot::kill
