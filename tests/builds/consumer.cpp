// SPDX-License-Identifier: Apache-2.0

// A program of somebody else that uses all of the public interface. tests/builds/builds.py compiles
// it by each compiler, with and without RTTI and exceptions, and links it with each form of the
// library.
//
//     consumer                everything, in one process
//     consumer names          what its message types are called, and the hashes of their
//     descriptions consumer publish        sends messages to one reader consumer subscribe reads
//     them consumer publish_plain, subscribe_plain    the same with a message without containers
//     consumer wrong          subscribes to a topic of another type: an error

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <type_traits>
#include <unordered_set>
#include <utility>
#include <vector>

#include <lot/boost_containers.hpp>
#include <lot/fuzz.hpp>
#include <lot/lot.hpp>

namespace {

using namespace std::chrono_literals;

struct Hidden {
  std::uint32_t number;
};

}  // namespace

namespace consumer {

enum class Colour : std::uint8_t { Red, Green };

inline namespace v1 {
template <class T, int N>
struct Box {
  T content[N];
};
}  // namespace v1

struct Point {
  double x, y;
};
struct Frame {
  std::uint32_t width, height;
  Colour colour;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
  lot::ShmVector<lot::ShmString> labels;
  std::atomic<std::uint32_t> looks;
};
LOT_DESCRIBE(Frame, width, height, colour, encoding, data, labels, looks);
struct Detection {
  lot::ShmRef<const Frame> frame;
  std::pair<float, float> corner;
};
struct Objects {
  lot::ShmMap<std::uint32_t, lot::ShmString> names;
  lot::ShmFlatSet<std::uint32_t> numbers;
  lot::ShmList<Point> path;
  lot::ShmDeque<std::uint32_t> queue;
  lot::ShmSmallVector<std::uint32_t, 4> few;
};
struct Base {
  std::uint32_t kind;
};
struct Derived : Base {
  std::uint32_t more;
};
/// The compiler alone cannot look into it.
class Vouched {
 public:
  Vouched() = default;
  explicit Vouched(int value) : value_(value) {}
  int value() const { return value_; }

 private:
  int value_ = 0;
};
struct Named {
  std::uint64_t number;
};
struct Task {
  std::uint32_t number;
};
struct Text {
  lot::ShmString text;
};
/// Some compilers have addresses of these fields, others have not.
struct __attribute__((packed)) Packed {
  std::uint8_t id;
  double x;
  Point point;
  unsigned few : 5;
  unsigned rest : 27;
  std::uint32_t number;
};

}  // namespace consumer

template <>
struct lot::is_trusted_message<consumer::Derived> : std::true_type {};
template <>
struct lot::is_trusted_message<consumer::Vouched> : std::true_type {};
template <>
struct lot::TypeIdentity<consumer::Named> {
  static const char* name() { return "example/Named"; }
  static constexpr std::uint64_t hash() { return 7; }
};

namespace {

using namespace consumer;

/// Ends the program where something is not as it should be.
void must(bool good, const char* what, int line) {
  if (good) return;
  std::fprintf(stderr, "consumer.cpp:%d: %s\n", line, what);
  std::exit(1);
}
#define MUST(condition) must(static_cast<bool>(condition), #condition, __LINE__)

lot::PusherOptions blocking() {
  lot::PusherOptions options;
  options.policy = lot::Policy::Block;
  options.depth = 8;
  return options;
}

void messages(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Frame>("/frames", blocking());
  auto puller = engine.subscribe<Frame>("/frames");
  pusher.reserve(2, 1 << 16);
  MUST(pusher.wait_for_readers(1, 1s) && pusher.readers() == 1 && puller.publishers() == 1);

  lot::ShmUniquePtr<Frame> frame = pusher.loan();
  frame->encoding = "a text that is longer than what lies in the string itself";
  frame->data.resize(1 << 16);
  frame->labels.emplace_back("front");
  frame->labels.resize(3);
  frame->colour = Colour::Green;
  frame->looks = 1;
  frame->data[4711] = 42;
  MUST(pusher.push(std::move(frame)) == lot::Status::Ok && frame == nullptr);
  MUST(puller.size() == 1);
  if (auto look = puller.borrow(1s)) {
    MUST(look->data[4711] == 42 && look->labels.size() == 3 && look.missed() == 0);
    const lot::ShmSharedPtr<const Frame> kept = look.keep();
    look.end();
    MUST(kept->encoding.size() > 40 && kept.use_count() == 1);
    MUST(pusher.push(kept) == lot::Status::Ok);
  } else {
    MUST(!"borrow()");
  }
  const auto again = puller.pull_until(std::chrono::steady_clock::now() + 1s);
  MUST(again && again->labels[0] == "front" && puller.missed_total() == 0);
  MUST(!puller.try_pull() && puller.status() == lot::Status::Empty);
  MUST(std::strcmp(lot::to_string(puller.status()), "empty") == 0);
  MUST(!puller.try_borrow() && puller.fd() >= 0);

  auto unsent = pusher.try_loan();
  MUST(unsent != nullptr);
  unsent.reset();

  auto objects = engine.make<Objects>();
  objects->names[7] = "pedestrian";
  objects->numbers.insert(3);
  objects->path.push_back(Point{1, 2});
  objects->queue.push_front(1);
  objects->few.assign(9, 1);
  MUST(objects->names.size() == 1 && objects->few.size() == 9);

  auto detections = engine.advertise<Detection>("/detections");
  auto seen = engine.subscribe<Detection>("/detections");
  auto detection = detections.loan();
  detection->frame = again;
  auto other = engine.make<Detection>();
  swap(other->frame, detection->frame);
  MUST(!detection->frame && other->frame.get() == again.get());
  other->frame.swap(detection->frame);
  MUST(detections.push(std::move(detection)) == lot::Status::Ok);
  const auto found = seen.pull(1s);
  MUST(found && found->frame.lock() == again);
  lot::ShmRef<const Frame> here = found->frame;
  MUST(here == found->frame && here != nullptr && std::hash<lot::ShmRef<const Frame>>()(here) != 0);
  here.reset();

  (void)engine.make<Vouched>(3);
  (void)engine.advertise<Box<std::uint16_t, 3>>("/box");
  (void)engine.advertise<Named>("/named");
  MUST(!engine.path().empty());
}

/// What programs without the type do.
void values(lot::ShmEngine& engine) {
  const std::string long_text(100, 'x');
  auto frame = engine.make<Frame>();
  lot::detail::Arena* const arena = frame->encoding.get_allocator().arena();
  std::memset(static_cast<void*>(frame.get()), 0x5a, sizeof(Frame));
  const lot::MutableValue made =
      lot::detail::mutable_value_of(lot::describe<Frame>(), frame.get(), arena);
  made.construct();
  made.at("width").set(640);
  made.at("colour").set(Colour::Green);
  made.at("encoding").set(long_text);
  made.at("data").resize(1000);
  made.at("data[999]").set(7);
  made.at("labels").resize(2);
  made.at("labels[1]").set("short");
  made.at("labels").resize(9);
  MUST(frame->width == 640 && frame->colour == Colour::Green && frame->data[999] == 7);
  MUST(std::string_view(frame->encoding.data(), frame->encoding.size()) == long_text);
  MUST(frame->labels.size() == 9 && frame->labels[1] == "short" && frame->labels[8].empty());
  frame->labels[1] += long_text.c_str();  // the type's code goes on
  frame->labels.resize(20);
  frame->encoding = "short";

  const lot::AnyMessage message = lot::ShmSharedPtr<Frame>(std::move(frame));
  const lot::Value root = message.root();
  MUST(root["width"].as<int>() == 640 && root.at("data[999]").as<std::uint8_t>() == 7);
  MUST(root["data"].bytes().size() == 1000 && root["labels"].size() == 20);
  MUST(root["labels"][1].as<std::string>() == "short" + long_text);
  MUST(root["encoding"].as<std::string_view>() == "short");
  std::size_t fields = 0;
  for (const lot::Value& field : root) fields += field.name().empty() ? 0 : 1;
  MUST(fields == 7 && message.as<Frame>()->width == 640 && !message.as<Text>());
  auto puller = engine.subscribe<Frame>("/any");
  auto pusher = engine.advertise_any("/any", message.type());
  auto any = engine.subscribe_any("/any");
  lot::AnyLoan loan = pusher.loan();
  loan.root()["width"].set(7);
  MUST(pusher.push(std::move(loan)) == lot::Status::Ok && puller.try_pull()->width == 7);
  MUST(any.try_borrow().root()["width"].as<int>() == 7);
  MUST(pusher.push(message) == lot::Status::Ok && puller.try_pull() == message.as<Frame>());
  MUST(any.try_pull().as<Frame>() == message.as<Frame>());
  std::ostringstream text;
  text << root["labels"];
  MUST(text.str().find("[\"\", \"shortxxx") == 0);
}

void pointers(lot::ShmEngine& engine) {
  lot::ShmUniquePtr<Derived> made = engine.make<Derived>();
  made->kind = 1;
  lot::ShmUniquePtr<Base> base = std::move(made);
  lot::ShmSharedPtr<Base> shared(std::move(base));
  const auto derived = lot::static_pointer_cast<Derived>(shared);
  const lot::ShmSharedPtr<const Base> constant = lot::make_const(shared);
  MUST(lot::const_pointer_cast<Base>(constant) == shared && constant->kind == 1);
  MUST(lot::reinterpret_pointer_cast<std::uint32_t>(shared) != nullptr);
#ifdef __cpp_rtti
  MUST(lot::dynamic_pointer_cast<const Base>(constant) == constant);
#endif
  const lot::ShmSharedPtr<const std::uint32_t> part(shared, &shared->kind);
  MUST(*part == 1 && !part.owner_before(shared) && lot::to_raw_pointer(part) == &shared->kind);
  lot::ShmWeakPtr weak(shared);
  MUST(weak.lock() == shared && weak.use_count() == shared.use_count() && !weak.expired());
  std::set<lot::ShmSharedPtr<Base>, lot::owner_less> ordered{shared};
  MUST(ordered.count(shared) == 1 && ordered.count(weak.lock()) == 1);
  std::unordered_set<lot::ShmSharedPtr<Base>> hashed{shared};
  MUST(hashed.size() == 1 && !(shared < shared) && shared >= shared);
  MUST(shared > nullptr && nullptr < shared && shared >= nullptr && nullptr <= shared);
  MUST(!(shared < nullptr || nullptr > shared || shared <= nullptr || nullptr >= shared));
#if __cplusplus >= 202002L
  MUST((shared <=> constant) == 0 && (shared <=> nullptr) > 0 && (nullptr <=> shared) < 0);
#endif
  std::ostringstream text;
  text << shared;
  MUST(!text.str().empty());
  lot::ShmSharedPtr<Base> a = shared;
  lot::ShmSharedPtr<Base> b;
  swap(a, b);
  MUST(a == nullptr && nullptr != b && lot::ShmSharedPtr(weak) == b && !b.unique());

  const lot::ShmString word = "word";
  MUST(std::hash<lot::ShmString>()(word) == std::hash<std::string_view>()("word"));
  lot::ShmVector<int> heap{1, 2, 3};
  heap.push_back(4);
  MUST(heap.size() == 4);
}

void queues(lot::ShmEngine& engine) {
  auto tasks = engine.queue<lot::ShmUniquePtr<Task>>("tasks");
  MUST(tasks.put(tasks.make(Task{1})) == lot::Status::Ok);
  MUST(tasks.emplace(Task{2}) == lot::Status::Ok && tasks.size() == 2 && tasks.capacity() == 64);
  MUST(tasks.put_for(tasks.make(Task{3}), 1s) == lot::Status::Ok);
  MUST(tasks.wait_and_pop()->number == 1 && (*tasks.wait_and_pop_for(1s))->number == 2);
  MUST((*tasks.try_pop())->number == 3 && tasks.is_empty());

  auto texts = engine.queue<Text>("texts");
  Text text;
  text.text = "a value that comes back by a copy, which may throw";
  MUST(texts.try_put(text) == lot::Status::Ok && texts.try_put(Text(text)) == lot::Status::Ok);
  MUST(texts.wait_and_pop().text == text.text && texts.try_pop()->text == text.text);

  auto all = engine.queue<lot::ShmSharedPtr<const Task>>("all");
  all.listen();
  const lot::ShmSharedPtr<const Task> item = all.make(Task{4});
  MUST(all.put(item) == lot::Status::Ok && all.wait_and_pop()->number == 4);

  lot::QueueOptions redeliver;
  redeliver.redeliver = true;
  auto jobs = engine.queue<Task>("jobs", redeliver);
  MUST(jobs.put(Task{5}) == lot::Status::Ok);
  lot::ShmTask<Task> job = jobs.wait_and_take();
  MUST(job->number == 5 && job.deliveries() == 1);
  job.give_back();
  job = jobs.try_take();
  MUST(job && job.deliveries() == 2);
  job.finish();
}

void waiting(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Hidden>("/hidden");
  auto puller = engine.subscribe<Hidden>("/hidden");
  std::uint32_t sum = 0;
  lot::WaitSet set;
  set.add(puller, [&] {
    while (auto message = puller.try_pull()) sum += message->number;
    set.stop();
  });
  const auto timer = set.add_timer(1h, [] {});
  set.add_timer_once(1ms, [&] { MUST(pusher.push(pusher.loan(Hidden{5})) == lot::Status::Ok); });
  set.run();
  set.remove(timer);
  set.remove(puller);
  MUST(sum == 5 && set.run_once(0ms) == 0);

  std::atomic<std::uint32_t> heard{0};
  {
    lot::ThreadOptions thread;
    thread.name = "consumer";
    const lot::ShmListener listener = engine.listen<Hidden>(
        "/hidden",
        [&](const lot::ShmSharedPtr<const Hidden>& message) { heard += message->number; },
        lot::PullerOptions(), thread);
    MUST(pusher.push(pusher.loan(Hidden{6})) == lot::Status::Ok);
    for (int n = 0; n < 10000 && heard == 0; ++n) ::usleep(1000);
  }
  MUST(heard == 6);
}

void stops(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Hidden>("/stops", blocking());
  auto puller = engine.subscribe<Hidden>("/stops");
  auto tasks = engine.queue<lot::ShmUniquePtr<Task>>("stops");
  lot::StopSource source;
  const lot::StopToken stop = source.get_token();
  MUST(stop.stop_possible() && !lot::StopToken().stop_possible() && stop != lot::StopToken());
  MUST(pusher.push(pusher.loan(Hidden{1}), stop) == lot::Status::Ok);
  MUST(puller.pull(1s, stop) && tasks.put(tasks.make(Task{1}), stop) == lot::Status::Ok);
  lot::WaitSet set;
  std::uint32_t taken = 0;
  set.add(tasks, [&] {
    while (auto task = tasks.try_pop()) taken += (*task)->number;
    source.request_stop();
  });
  set.run(stop);
  MUST(taken == 1 && stop.stop_requested() && tasks.fd() >= 0);
  MUST(!puller.pull(stop) && puller.status() == lot::Status::Stopped && !puller.borrow(stop));
  MUST(!tasks.wait_and_pop(stop) && pusher.push(pusher.loan(Hidden{2}), stop) != lot::Status::Ok);
  MUST(!lot::stop_on_signals().stop_requested());
}

void services(lot::ShmEngine& engine) {
  const auto server = engine.serve<Task, Text>(
      "consumer", [](const Task& task, Text& text) { text.text.assign(task.number, 'x'); });
  auto client = engine.client<Task, Text>("consumer");
  MUST(client.wait_for_server(1s) && client.servers() == 1);
  auto request = client.loan();
  request->number = 50;
  const auto answer = client.call(std::move(request), 10s);
  MUST(answer && answer->text.size() == 50 && client.status() == lot::Status::Ok);
  MUST(client.call(Task{7})->text.size() == 7);
}

void errors(lot::ShmEngine& engine) {
  const auto pusher = engine.advertise<Named>("/errors");
#ifdef __cpp_exceptions
  const auto number_of = [](auto&& step) {
    try {
      step();
    } catch (const lot::Error& error) {
      return error.error_number();
    } catch (const std::bad_alloc&) {  // lot::OutOfMemory, too
      return ENOMEM;
    } catch (const std::bad_weak_ptr&) {
      return ESRCH;
    }
    return 0;
  };
  MUST(number_of([&] { (void)engine.subscribe<Task>("/errors"); }) == EPROTOTYPE);
  MUST(number_of([&] {
         auto big = engine.make<Text>();
         big->text.reserve(std::size_t{1} << 40);
       }) == ENOMEM);
  MUST(number_of([] { (void)lot::ShmAllocator<char>().allocate(~std::size_t{0}); }) == ENOMEM);
  MUST(number_of([] { lot::ShmSharedPtr<Task>(lot::ShmWeakPtr<Task>()); }) == ESRCH);
  lot::QueueOptions redeliver;
  redeliver.redeliver = true;
  MUST(number_of([&] {
         (void)engine.queue<lot::ShmSharedPtr<const Task>>("refused", redeliver);
       }) == EINVAL);
#endif
}

void fuzz() {
  std::vector<std::uint8_t> bytes(400);
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::uint8_t>(i * 37 % 251);
  const auto fill = [](Point& point, lot::fuzz::Bytes& from) {
    point.x = from.number<std::uint16_t>();
    point.y = from.byte();
  };
  const auto print = [](const Point& point) {
    return std::to_string(point.x) + " " + std::to_string(point.y);
  };
  lot::fuzz::queue<Point>(bytes.data(), bytes.size(), fill, print);
}

/// Prints what the library calls T.
template <class T>
void name() {
  std::puts(lot::TypeIdentity<T>::name());
}
template <class T>
void description() {
  const lot::Description& all = lot::describe<T>();
  std::printf("layout %llx, names %llx\n", static_cast<unsigned long long>(all.layout_hash()),
              static_cast<unsigned long long>(all.names_hash()));
}

/// What the programs of all compilers and standards print alike.
void names() {
  struct Local {
    int number;
  };
  name<Frame>();
  name<Hidden>();
  name<Named>();
  name<Local>();
  name<Box<unsigned long, 3>>();
  name<Box<Box<const char*, 1>, -2 + 4>>();
  name<Box<lot::ShmVector<lot::ShmString>, 1>>();
  name<std::pair<std::string, std::map<signed char, long long>>>();
  name<std::integral_constant<Colour, Colour::Green>>();
  name<int Point::*>();
  name<void (*)(Frame&, const volatile int*) noexcept>();
  name<long double[4]>();
  name<std::uint8_t>();
  description<Frame>();
  description<Packed>();
  std::printf("layout %llx\n",
              static_cast<unsigned long long>(lot::describe<Detection>().layout_hash()));
}

constexpr std::uint32_t kMessages = 200;

/// The topics are there: the reader may begin.
void ready() {
  std::puts("ready");
  std::fflush(stdout);
}

void publish(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Frame>("/pair", blocking());
  auto boxes = engine.advertise<Box<Hidden, 2>>("/pair/boxes", blocking());
  ready();
  MUST(pusher.wait_for_readers(1, 60s) && boxes.wait_for_readers(1, 60s));
  for (std::uint32_t n = 0; n < kMessages; ++n) {
    auto frame = pusher.loan();
    frame->width = n;
    frame->encoding = "message " + lot::ShmString(n % 40, 'x');
    frame->labels.resize(n % 5);
    MUST(pusher.push(std::move(frame), 60s) == lot::Status::Ok);
    MUST(boxes.push(boxes.loan(), 60s) == lot::Status::Ok);
  }
}
void subscribe(lot::ShmEngine& engine) {
  auto puller = engine.subscribe<Frame>("/pair");
  auto boxes = engine.subscribe<Box<Hidden, 2>>("/pair/boxes");
  for (std::uint32_t n = 0; n < kMessages; ++n) {
    const auto frame = puller.pull(60s);
    MUST(frame && frame->width == n && frame->labels.size() == n % 5);
    MUST(frame->encoding == "message " + lot::ShmString(n % 40, 'x'));
    MUST(boxes.borrow(60s));
  }
}
void publish_plain(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Point>("/plain", blocking());
  ready();
  MUST(pusher.wait_for_readers(1, 60s) && pusher.push(pusher.loan(Point{1, 2})) == lot::Status::Ok);
}
void subscribe_plain(lot::ShmEngine& engine) {
  const auto point = engine.subscribe<Point>("/plain").pull(60s);
  MUST(point && point->x == 1 && point->y == 2);
}
void wrong(lot::ShmEngine& engine) {
  const auto pusher = engine.advertise<Named>("/wrong");
  (void)engine.subscribe<Task>("/wrong");
}

void everything(lot::ShmEngine& engine) {
  messages(engine);
  values(engine);
  pointers(engine);
  queues(engine);
  waiting(engine);
  stops(engine);
  services(engine);
  errors(engine);
  fuzz();
}

}  // namespace

int main(int count, char** arguments) {
  const std::string role = count > 1 ? arguments[1] : "everything";
  if (role == "names") {
    names();
    return 0;
  }
  lot::end_cleanly_on_signals();
  lot::EngineOptions options;
  options.size_bytes = 64 << 20;
  options.name = "consumer";
  lot::ShmEngine engine(options);
  const std::map<std::string, void (*)(lot::ShmEngine&)> roles{{"everything", everything},
                                                               {"publish", publish},
                                                               {"subscribe", subscribe},
                                                               {"publish_plain", publish_plain},
                                                               {"subscribe_plain", subscribe_plain},
                                                               {"wrong", wrong}};
  const auto found = roles.find(role);
  MUST(found != roles.end());
  found->second(engine);
  std::puts("ok");
}
