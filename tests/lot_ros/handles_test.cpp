// SPDX-License-Identifier: Apache-2.0

// Handles of lot::ros in one node, and with a second one, and a real master: run by ros_test.py.
//
//     ros_handles_test --echo TOPIC    the second one: repeats on TOPIC/heard what TOPIC,
//     TOPIC/bool
//                                      and TOPIC/empty say; its LOT thread is held up for 1.5 s by
//                                      a message on TOPIC/hold

#define DOCTEST_CONFIG_IMPLEMENT
#include "handles.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <boost/make_shared.hpp>
#include <doctest/doctest.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <rosgraph_msgs/Log.h>
#include <sensor_msgs/Image.h>
#include <spawn.h>
#include <std_msgs/Bool.h>
#include <std_msgs/Empty.h>

namespace {

using namespace std::chrono_literals;
using lot::ros::test::comes;
using lot::ros::test::fresh_topic;
using lot::ros::test::say;
using lot::ros::test::String;
using Image = lot::ros::Message<sensor_msgs::Image_>;
using Empty = lot::ros::Message<std_msgs::Empty_>;
using Bool = lot::ros::Message<std_msgs::Bool_>;

/// A message type that is neither LOT's nor the standard one, but serialises to the same.
template <class T>
struct OtherAllocator : std::allocator<T> {
  template <class U>
  struct rebind {
    using other = OtherAllocator<U>;
  };
  OtherAllocator() = default;
  template <class U>
  OtherAllocator(const OtherAllocator<U>&) {}
};
using OtherString = std_msgs::String_<OtherAllocator<void>>;

/// Waits until it holds, and spins nothing. False: in vain for so long.
bool comes_unspun(const std::function<bool()>& condition, std::chrono::milliseconds most = 20s) {
  const auto until = std::chrono::steady_clock::now() + most;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > until) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

/// Whose callbacks LOT's thread calls.
lot::ros::NodeHandle immediate() {
  lot::ros::NodeHandle node;
  node.setCallbackQueue(lot::ros::immediate_queue());
  return node;
}

/// What a subscriber has heard.
struct Ear {
  std::vector<std::string> heard;
  auto callback() {
    return [this](const String& s) { heard.emplace_back(s.data.data(), s.data.size()); };
  }
};
using Words = std::vector<std::string>;

const char* const kHeldUp = "(held up)";
const char* const kGoesOn = "(goes on)";

int echo(int argc, char** argv) {
  ros::init(argc, argv, "echo", ros::init_options::AnonymousName);
  const std::string topic = argv[2];
  lot::ros::NodeHandle node;
  auto heard = node.advertise<String>(topic + "/heard", 1000);
  while (ros::ok() && heard.getNumSubscribers() == 0) std::this_thread::sleep_for(1ms);
  auto ear = node.subscribe<String>(
      topic, 1000, [&](const boost::shared_ptr<String const>& message) { heard.publish(message); });
  auto nothing =
      node.subscribe<Empty>(topic + "/empty", 10, [&](const Empty&) { say(heard, "nothing"); });
  auto word = node.subscribe<Bool>(
      topic + "/bool", 10, [&](const Bool& message) { say(heard, message.data ? "yes" : "no"); });
  auto hold = immediate().subscribe<String>(topic + "/hold", 10, [&](const String&) {
    say(heard, kHeldUp);
    while (ros::ok() && !ros::param::has(topic + "/go_on")) std::this_thread::sleep_for(1ms);
    say(heard, kGoesOn);
  });
  ros::spin();
  return 0;
}

/// A node of another process that hears a topic.
class Elsewhere {
 public:
  explicit Elsewhere(const std::string& topic) {
    listener_ = lot::ros::NodeHandle().subscribe<String>(topic + "/heard", 1000, ear_.callback());
    char program[] = "/proc/self/exe", echo[] = "--echo";
    std::string of = topic;
    char* const argv[] = {program, echo, of.data(), nullptr};
    REQUIRE(posix_spawn(&child_, program, nullptr, nullptr, argv, environ) == 0);
    CHECK(comes([this] { return listener_.getNumPublishers() == 1; }));
  }
  Elsewhere(const Elsewhere&) = delete;
  Elsewhere& operator=(const Elsewhere&) = delete;
  ~Elsewhere() {
    kill(child_, SIGINT);
    int status = -1;
    CHECK(waitpid(child_, &status, 0) == child_);
    CHECK(status == 0);
  }

  const Words& heard() const { return ear_.heard; }

 private:
  Ear ear_;
  lot::ros::Subscriber listener_;
  pid_t child_ = 0;
};

/// Counts on from `next` until some in a row were not sent on links. Returns what comes then.
std::size_t says_past_links(const lot::ros::Publisher<String>& talker, std::size_t next) {
  int in_a_row = 0;
  CHECK(comes([&] {
    const auto before = talker.by_link();
    say(talker, std::to_string(next++).c_str());
    in_a_row = talker.by_link() == before ? in_a_row + 1 : 0;
    return in_a_row == 20;
  }));
  return next;
}

}  // namespace

TEST_CASE("one topic has one type in a process") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto strings = node.advertise<String>(topic, 1);
  CHECK(strings);
  auto images = node.advertise<Image>(topic, 1);
  CHECK_FALSE(images);
  CHECK_FALSE(images.loan());
  auto heard = node.subscribe<String>(topic, 1, [](const String&) {});
  CHECK_THROWS_AS((void)node.subscribe<Image>(topic, 1, [](const Image&) {}),
                  ros::ConflictingSubscriptionException);
}

TEST_CASE("a header's number is the message's among the publisher's, as in roscpp") {
  lot::ros::NodeHandle node;
  const auto first = fresh_topic();
  const auto again = fresh_topic();
  std::vector<std::uint32_t> seen;
  std::vector<std::uint32_t> seen_again;
  boost::shared_ptr<Image const> last;
  auto talker = node.advertise<Image>(first, 10);
  auto repeater = node.advertise<Image>(again, 10);
  auto listener =
      node.subscribe<Image>(first, 10, [&](const boost::shared_ptr<Image const>& image) {
        seen.push_back(image->header.seq);
        last = image;
      });
  auto other = node.subscribe<Image>(
      again, 10, [&](const Image& image) { seen_again.push_back(image.header.seq); });
  REQUIRE(comes([&] { return listener.getNumPublishers() == 1 && other.getNumPublishers() == 1; }));
  for (int n = 0; n < 3; ++n) {
    auto image = talker.loan();
    image->header.seq = 77;
    talker.publish(std::move(image));
  }
  sensor_msgs::Image standard;
  standard.header.seq = 77;
  talker.publish(standard);
  REQUIRE(comes([&] { return seen.size() == 4; }));
  for (std::size_t n = 1; n < seen.size(); ++n) CHECK(seen[n] == seen[0] + n);
  CHECK(seen[0] <= 1);
  repeater.publish(last);
  REQUIRE(comes([&] { return seen_again.size() == 1; }));
  CHECK(seen_again[0] == seen[3]);
}

TEST_CASE("a callback may own other handles, and go with the last one of its subscriber") {
  lot::ros::NodeHandle node;
  const auto in = fresh_topic();
  const auto out = fresh_topic();
  Ear ear;
  auto listener = node.subscribe<String>(out, 10, ear.callback());
  auto talker = node.advertise<String>(in, 10);
  auto relay = node.subscribe<String>(
      in, 10,
      [publisher = node.advertise<String>(out, 10)](const boost::shared_ptr<String const>& s) {
        publisher.publish(s);
      });
  REQUIRE(
      comes([&] { return talker.getNumSubscribers() == 1 && listener.getNumPublishers() == 1; }));
  say(talker, "through");
  CHECK(comes([&] { return ear.heard == Words{"through"}; }));
  relay = {};  // hangs where a lock is held that the other handle's end needs, too
  CHECK(comes([&] { return listener.getNumPublishers() == 0; }));
}

TEST_CASE("a subscriber is shut down by two threads, while its callback makes others") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 100);
  for (int round = 0; round < 20; ++round) {
    auto subscriber = std::make_shared<lot::ros::Subscriber>();
    std::atomic<int> called{0};
    *subscriber = node.subscribe<String>(topic, 100, [&](const String&) {
      ++called;
      auto another = node.advertise<String>(topic + "/other", 1);
      auto other = node.subscribe<String>(topic + "/other", 1, [](const String&) {});
    });
    REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
    for (int i = 0; i < 5; ++i) say(talker, "x");
    std::thread spinner([&] {
      for (int i = 0; i < 20; ++i) {
        ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.001));
      }
    });
    auto copy = *subscriber;
    std::thread one([&] { subscriber->shutdown(); });
    std::thread two([&] { copy.shutdown(); });
    one.join();
    two.join();
    const int so_far = called;
    spinner.join();
    CHECK(called <= so_far + 1);
    CHECK(comes([&] { return talker.getNumSubscribers() == 0; }));
  }
}

TEST_CASE("a counted subscriber gets what is published next") {
  ros::NodeHandle plain;
  lot::ros::NodeHandle node;
  for (int round = 0; round < 300; ++round) {
    const auto topic = fresh_topic();
    auto talker = node.advertise<String>(topic, 10);
    auto message = talker.loan();
    message->data = "at once";
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    std::thread waits([&] {
      while (talker.getNumSubscribers() == 0 && std::chrono::steady_clock::now() < until) {
      }
      talker.publish(std::move(message));
    });
    Words heard;
    auto listener = plain.subscribe<std_msgs::String>(
        topic, 10, [&](const std_msgs::StringConstPtr& s) { heard.push_back(s->data); });
    waits.join();
    REQUIRE(comes([&] { return heard == Words{"at once"}; }));
  }
}

TEST_CASE("a copy for which shared memory has no room goes over TCPROS, and one warning says so") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  ::ros::NodeHandle plain;
  std::size_t warnings = 0;
  auto log = plain.subscribe<rosgraph_msgs::Log>(
      "/rosout", 100, [&](const rosgraph_msgs::LogConstPtr& line) {
        if (line->level == rosgraph_msgs::Log::WARN &&
            line->msg.find("LOT: " + topic + " goes over TCPROS for a message") == 0) {
          ++warnings;
        }
      });
  std::size_t got = 0;
  lot::ros::Subscriber listener;
  std::optional<Elsewhere> there;
  bool is_here = false;
  SUBCASE("in this process") {
    is_here = true;
    listener = node.subscribe<String>(topic, 10, [&](const String& s) { got = s.data.size(); });
  }
  SUBCASE("in another one") { there.emplace(topic); }
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  says_past_links(talker, 0);
  const auto before = talker.serialised();
  auto large = boost::make_shared<std_msgs::String>();
  large->data.assign(50 << 20, 'x');
  {
    std::vector<lot::ros::Loan<String>> all;
    CHECK_THROWS_AS(
        for (;;) {
          all.push_back(talker.loan());
          all.back()->data.resize(32 << 20);
        },
        lot::OutOfMemory);
    talker.publish(large);
    talker.publish(large);
    CHECK(talker.serialised() == before + 2);
    CHECK(comes([&] {
      return is_here ? got == large->data.size()
                     : !there->heard().empty() && there->heard().back() == large->data;
    }));
    CHECK(comes([&] { return warnings != 0; }));
  }
  says_past_links(talker, 0);
  CHECK(warnings == 1);
}

TEST_CASE("a publisher that is shut down publishes no more, whatever copies there are") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  Ear ear;
  auto listener = node.subscribe<String>(topic, 10, ear.callback());
  auto talker = node.advertise<String>(topic, 10);
  auto copy = talker;
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, "first");
  CHECK(comes([&] { return ear.heard.size() == 1; }));
  talker.shutdown();
  CHECK_FALSE(talker);
  CHECK_FALSE(copy);
  CHECK(copy.getTopic().empty());
  copy.publish(String());
  CHECK(comes([&] { return listener.getNumPublishers() == 0; }));
  CHECK(ear.heard == Words{"first"});
}

TEST_CASE("a subscriber that is shut down is none, and another one of its topic goes on") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  Ear first, second;
  auto one = node.subscribe<String>(topic, 10, first.callback());
  auto other = node.subscribe<String>(topic, 10, second.callback());
  const auto copy = one;
  CHECK(one == copy);
  CHECK_FALSE(one == other);
  CHECK(one != other);
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return other.getNumPublishers() == 1; }));
  one.shutdown();
  CHECK_FALSE(one);
  CHECK(one == lot::ros::Subscriber());
  CHECK(copy.getNumPublishers() == 0);
  CHECK(other.getNumPublishers() == 1);
  say(talker, "further");
  CHECK(comes([&] { return second.heard == Words{"further"}; }));
  CHECK(first.heard.empty());
}

TEST_CASE("a late subscriber gets what each publisher has latched, and so does one beside it") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto a = node.advertise<String>(topic, 10, true);
  say(a, "a0");
  say(a, "a1");
  Ear first, second, plain;
  auto early = node.subscribe<String>(topic, 10, first.callback());
  CHECK(comes([&] { return first.heard == Words{"a1"}; }));
  auto late = node.subscribe<String>(topic, 10, second.callback());
  CHECK(comes([&] { return second.heard == Words{"a1"}; }));
  CHECK(first.heard == Words{"a1"});
  say(a, "a2");
  CHECK(comes([&] {
    return first.heard == Words{"a1", "a2"} && second.heard == Words{"a1", "a2"};
  }));
}

TEST_CASE("two latching publishers of one topic: the late one gets both") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto a = node.advertise<String>(topic, 10, true);
  auto b = node.advertise<String>(topic, 10, true);
  say(a, "a");
  say(b, "b");
  Ear ear;
  auto late = node.subscribe<String>(topic, 10, ear.callback());
  say(b, "b again");
  CHECK(comes([&] { return ear.heard.size() >= 2 && ear.heard.back() == "b again"; }));
  CHECK(std::set<std::string>(ear.heard.begin(), ear.heard.end()).count("a") == 1);
}

TEST_CASE("LOT's pointer for subscribers by roscpp's own NodeHandle") {
  const auto topic = fresh_topic();
  ros::NodeHandle plain;
  std::string heard;
  auto subscriber = plain.subscribe<String, const lot::ShmSharedPtr<const String>&>(
      topic, 1,
      boost::function<void(const lot::ShmSharedPtr<const String>&)>(
          [&](const lot::ShmSharedPtr<const String>& s) {
            heard.assign(s->data.data(), s->data.size());
          }));
  auto publisher = plain.advertise<std_msgs::String>(topic, 1);
  REQUIRE(comes([&] { return publisher.getNumSubscribers() == 1; }));
  std_msgs::String message;
  message.data = "copied into shared memory";
  publisher.publish(message);
  CHECK(comes([&] { return heard == message.data; }));
}

TEST_CASE("messages of no byte, and of one, go to other processes by links") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto nothing = node.advertise<Empty>(topic + "/empty", 10);
  auto word = node.advertise<Bool>(topic + "/bool", 10, true);
  int nothings = 0;
  std::vector<bool> words;
  const auto publish = [&] {
    for (int i = 0; i < 4; ++i) {
      nothing.publish(Empty());
      auto message = word.loan();
      message->data = i % 2 != 0;
      word.publish(std::move(message));
    }
  };
  const auto have_subscribers = [&] {
    return nothing.getNumSubscribers() == 1 && word.getNumSubscribers() == 1;
  };
  SUBCASE("in this process they are handed over") {
    auto hears_nothing =
        node.subscribe<Empty>(topic + "/empty", 10, [&](const Empty&) { ++nothings; });
    auto hears_words = node.subscribe<Bool>(
        topic + "/bool", 10, [&](const Bool& message) { words.push_back(message.data); });
    REQUIRE(comes(have_subscribers));
    publish();
    CHECK(comes([&] { return nothings == 4 && words.size() == 4; }));
    CHECK(words == std::vector<bool>{false, true, false, true});
    CHECK(word.serialised() == 0);
  }
  SUBCASE("in another one") {
    const Elsewhere there(topic);
    REQUIRE(comes(have_subscribers));
    publish();
    CHECK(comes([&] { return there.heard().size() == 8; }));
    Words said = there.heard();
    said.erase(std::remove(said.begin(), said.end(), "nothing"), said.end());
    CHECK(said == Words{"no", "yes", "no", "yes"});
    CHECK(word.serialised() == 4);
  }
}

TEST_CASE("a connect callback's own message comes first, and the others follow it") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  std::atomic<bool> greeted{false};
  auto talker = node.advertise<String>(topic, 100, [&](const ros::SingleSubscriberPublisher& peer) {
    String hello;
    hello.data = "hello";
    peer.publish(hello);
    greeted = true;
  });
  const auto check = [&](const Words& heard) {
    REQUIRE(comes([&] { return greeted.load(); }));
    say(talker, "1");
    say(talker, "2");
    CHECK(comes([&] { return heard.size() == 3; }));
    CHECK(heard == Words{"hello", "1", "2"});
    const auto said = says_past_links(talker, 3);
    CHECK(comes([&] { return heard.size() == said; }));
    for (std::size_t i = 1; i < said; ++i) CHECK(heard[i] == std::to_string(i));
  };
  SUBCASE("in this process") {
    Ear ear;
    auto listener = node.subscribe<String>(topic, 100, ear.callback());
    check(ear.heard);
  }
  SUBCASE("in another one") {
    const Elsewhere there(topic);
    check(there.heard());
  }
}

TEST_CASE("two publishers of a topic greet, at any time, and what they say comes in its order") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  const auto greeter = [](const char* word) {
    return [word](const ros::SingleSubscriberPublisher& peer) {
      String hello;
      hello.data = word;
      peer.publish(hello);
    };
  };
  Ear ear;
  auto listener = node.subscribe<String>(topic, 100, ear.callback());
  auto first = node.advertise<String>(topic, 100, greeter("first"));
  REQUIRE(comes([&] { return ear.heard == Words{"first"}; }));
  for (int i = 1; i < 10; ++i) say(first, std::to_string(i).c_str());
  CHECK(comes([&] { return ear.heard.size() == 10; }));
  auto second = node.advertise<String>(topic, 100, greeter("second"));
  REQUIRE(comes([&] { return ear.heard.size() == 11; }));
  CHECK(ear.heard.back() == "second");
  for (int i = 11; i < 20; ++i) say(second, std::to_string(i).c_str());
  CHECK(comes([&] { return ear.heard.size() == 20; }));
  for (int i = 1; i < 20; ++i) {
    if (i != 10) CHECK(ear.heard[std::size_t(i)] == std::to_string(i));
  }
  const auto said = says_past_links(first, 20);
  CHECK(comes([&] { return ear.heard.size() == said; }));
  for (std::size_t i = 20; i < said; ++i) CHECK(ear.heard[i] == std::to_string(i));
}

TEST_CASE("a reader that comes too late is served by its link, and then by the ring") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  const Elsewhere there(topic);
  auto hold = node.advertise<String>(topic + "/hold", 10);
  REQUIRE(comes([&] { return hold.getNumSubscribers() == 1; }));
  say(hold, "");
  REQUIRE(comes([&] { return there.heard() == Words{kHeldUp}; }));
  auto talker = node.advertise<String>(topic, 1000);
  CHECK(comes([&] { return talker.getNumSubscribers() == 1; }));
  std::size_t next = 0;
  CHECK(comes([&] {
    say(talker, std::to_string(next++).c_str());
    return talker.by_link() > 0;
  }));
  ros::param::set(topic + "/go_on", true);
  CHECK(comes([&] {
    say(talker, std::to_string(next++).c_str());
    return there.heard().size() > 1;
  }));
  const auto said = says_past_links(talker, next);
  CHECK(comes([&] { return there.heard().size() == said + 2; }));
  Words heard = there.heard();
  heard.erase(std::remove_if(heard.begin(), heard.end(),
                             [](const std::string& word) { return word[0] == '('; }),
              heard.end());
  REQUIRE(heard.size() == said);
  for (std::size_t i = 0; i < said; ++i) CHECK(heard[i] == std::to_string(i));
}

TEST_CASE("publishers are told which subscribers come and go, and spinOnce() calls back") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  std::vector<std::string> came;
  std::vector<std::string> went;
  auto talker = node.advertise<String>(
      topic, 10,
      [&](const ros::SingleSubscriberPublisher& peer) { came.push_back(peer.getSubscriberName()); },
      [&](const ros::SingleSubscriberPublisher& peer) {
        went.push_back(peer.getSubscriberName());
      });
  const auto spun = [](const std::function<bool()>& condition) {
    return comes_unspun([&] {
      ros::spinOnce();
      return condition();
    });
  };
  const Words here{ros::this_node::getName()};
  for (int round = 0; round < 2; ++round) {
    came.clear();
    went.clear();
    Ear ear;
    auto listener = node.subscribe<String>(topic, 10, ear.callback());
    CHECK(spun([&] { return came == here; }));
    say(talker, "heard");
    CHECK(spun([&] { return ear.heard == Words{"heard"}; }));
    CHECK(went.empty());
    listener.shutdown();
    CHECK(spun([&] { return went == here; }));
    CHECK(came == here);
  }
}

TEST_CASE("several threads publish; each NodeHandle has a callback queue and spinners") {
  constexpr int kThreads = 4;
  constexpr int kEach = 100;
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  ros::CallbackQueue first_queue;
  ros::CallbackQueue second_queue;
  lot::ros::NodeHandle first(node);
  lot::ros::NodeHandle second(node, "elsewhere");
  first.setCallbackQueue(&first_queue);
  second.setCallbackQueue(&second_queue);
  std::mutex mutex;
  std::vector<std::vector<int>> in_order(kThreads);  // numbers of each publishing thread
  std::multiset<std::string> all;
  const auto one_at_a_time = first.subscribe<String>(topic, 1000, [&](const String& s) {
    const std::string text(s.data.data(), s.data.size());
    const std::lock_guard guard(mutex);
    in_order.at(std::stoul(text)).push_back(std::stoi(text.substr(text.find(' '))));
  });
  ros::SubscribeOptions options = ros::SubscribeOptions::create<String>(
      topic, 1000,
      [&](const boost::shared_ptr<String const>& s) {
        const std::lock_guard guard(mutex);
        all.emplace(s->data.data(), s->data.size());
      },
      ros::VoidConstPtr(), nullptr);
  options.allow_concurrent_callbacks = true;
  const auto many_at_once = second.subscribe<String>(options);
  CHECK(second.getNamespace() == "/elsewhere");
  ros::AsyncSpinner first_spinner(1, &first_queue);
  ros::AsyncSpinner second_spinner(3, &second_queue);
  first_spinner.start();
  second_spinner.start();
  auto talker = node.advertise<String>(topic, 1000);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&talker, t] {
      for (int i = 0; i < kEach; ++i) {
        say(talker, (std::to_string(t) + ' ' + std::to_string(i)).c_str());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  CHECK(comes([&] {
    const std::lock_guard guard(mutex);
    std::size_t n = 0;
    for (const auto& numbers : in_order) n += numbers.size();
    return n == kThreads * kEach && all.size() == kThreads * kEach;
  }));
  const std::lock_guard guard(mutex);
  for (const auto& numbers : in_order) {
    REQUIRE(numbers.size() == kEach);
    CHECK(std::is_sorted(numbers.begin(), numbers.end()));
  }
  CHECK(std::set<std::string>(all.begin(), all.end()).size() == all.size());
  CHECK(talker.serialised() == 0);
}

TEST_CASE("a subscription that is made while the last one of its topic ends hears all the same") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 10);
  for (int round = 0; round < 30; ++round) {
    const void* heard = nullptr;
    auto old = node.subscribe<String>(topic, 10, [](const String&) {});
    REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
    std::thread ends([&] { old.shutdown(); });
    auto listener = node.subscribe<String>(
        topic, 10, [&](const boost::shared_ptr<String const>& message) { heard = message.get(); });
    ends.join();
    REQUIRE(
        comes([&] { return talker.getNumSubscribers() == 1 && listener.getNumPublishers() == 1; }));
    auto message = talker.loan();
    const void* const sent = message.get();
    talker.publish(std::move(message));
    CHECK(comes([&] { return heard != nullptr; }));
    CHECK(heard == sent);  // it was not serialised
  }
}

TEST_CASE("memory that was reserved is used") {
  lot::ros::NodeHandle node;
  auto talker = node.advertise<Image>(fresh_topic(), 4);
  talker.reserve(4, 1 << 20);
  auto image = talker.loan();
  image->data.resize(1 << 20);
  CHECK(image.is_shared());
  lot::ros::Publisher<Image>().reserve(1, 1);  // nobody's: nothing
}

TEST_CASE("plain subscribers of the publisher's process get messages that no code serialises") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  Words heard;
  auto plain = node.subscribe<std_msgs::String>(
      topic, 10, [&](const std_msgs::String& s) { heard.push_back(s.data); });
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, "one");
  say(talker, "two");
  CHECK(comes([&] { return heard == Words{"one", "two"}; }));
  CHECK(talker.serialised() == 0);
}

TEST_CASE("a burst is heard once, and what follows, when a plain subscriber is found") {
  lot::ros::NodeHandle node;
  constexpr std::size_t kBurst = 99;
  constexpr std::size_t kMore = 200;
  for (int round = 0; round < 5; ++round) {
    const auto topic = fresh_topic();
    Words heard;
    Words plain_heard;
    auto listener = node.subscribe<String>(
        topic, 1000, [&](const String& s) { heard.emplace_back(s.data.data(), s.data.size()); });
    auto plain = node.subscribe<std_msgs::String>(
        topic, 1000, [&](const std_msgs::String& s) { plain_heard.push_back(s.data); });
    auto talker = node.advertise<String>(topic, 100);
    REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
    Words said;
    const auto tell = [&](std::size_t count) {
      for (std::size_t n = 0; n < count; ++n) {
        said.push_back(std::to_string(said.size()));
        say(talker, said.back().c_str());
      }
    };
    tell(kBurst);
    CHECK(comes([&] { return heard.size() >= kBurst && plain_heard.size() >= kBurst; }));
    for (std::size_t n = 0; n < kMore; n += 20) {
      tell(20);
      CHECK(comes([&] { return heard.size() >= said.size(); }));
    }
    CHECK(comes([&] { return plain_heard.size() >= said.size(); }));
    CHECK(heard == said);
    CHECK(plain_heard == said);
  }
}

// ---- from a publisher of this process
// ------------------------------------------------------------

TEST_CASE("the thread that publishes fills the queues of its process, not LOT's thread") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  std::atomic<bool> is_held_up{false};
  std::atomic<bool> goes_on{false};
  auto holds_up = immediate().subscribe<String>(topic + "/hold", 10, [&](const String&) {
    is_held_up = true;
    comes_unspun([&] { return goes_on.load(); });
  });
  auto hold = node.advertise<String>(topic + "/hold", 10);
  Words heard;
  std::set<const void*> sent, places;
  auto listener =
      node.subscribe<String>(topic, 100, [&](const boost::shared_ptr<String const>& message) {
        heard.emplace_back(message->data.data(), message->data.size());
        places.insert(message.get());
      });
  auto talker = node.advertise<String>(topic, 100);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  REQUIRE(comes([&] { return hold.getNumSubscribers() == 1; }));
  say(talker, "first");  // what links have brought before the first one, LOT's thread must know
  REQUIRE(comes([&] { return heard.size() == 1; }));
  heard.clear();
  places.clear();
  say(hold, "");
  REQUIRE(comes_unspun([&] { return is_held_up.load(); }));
  Words said;
  for (int n = 0; n < 50; ++n) {
    said.push_back(std::to_string(n));
    auto message = talker.loan();
    message->data = said.back().c_str();
    sent.insert(message.get());
    talker.publish(std::move(message));
  }
  ros::getGlobalCallbackQueue()->callAvailable();
  CHECK(heard == said);
  CHECK(places == sent);
  CHECK(talker.by_link() == 0);
  goes_on = true;
}

TEST_CASE("four threads publish in one process, and what each says arrives in its order") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  constexpr int kThreads = 4, kEach = 200;
  std::vector<std::vector<int>> heard(kThreads);
  std::size_t all = 0;
  auto listener = node.subscribe<String>(topic, 0, [&](const String& s) {
    const std::string text(s.data.data(), s.data.size());
    heard[std::size_t(text[0] - 'a')].push_back(std::stoi(text.substr(1)));
    ++all;
  });
  auto talker = node.advertise<String>(topic, 1000);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      for (int n = 0; n < kEach; ++n) say(talker, (char('a' + t) + std::to_string(n)).c_str());
    });
  }
  for (auto& thread : threads) thread.join();
  CHECK(comes([&] { return all == kThreads * kEach; }));
  for (const auto& of_one : heard) {
    REQUIRE(of_one.size() == kEach);
    CHECK(std::is_sorted(of_one.begin(), of_one.end()));
  }
}

namespace {

/// Calls at once, on the thread that adds, as an application's own queue may.
class AtOnce final : public ros::CallbackQueueInterface {
 public:
  void addCallback(const ros::CallbackInterfacePtr& callback, std::uint64_t) override {
    callback->call();
  }
  void removeByID(std::uint64_t) override {}
};

}  // namespace

TEST_CASE("a queue that calls at once publishes the same topic again") {
  AtOnce queue;
  lot::ros::NodeHandle node;
  node.setCallbackQueue(&queue);
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 100);
  Ear ear;
  auto listener = node.subscribe<String>(topic, 100, [&](const String& s) {
    ear.callback()(s);
    if (ear.heard.size() < 10) say(talker, std::to_string(ear.heard.size()).c_str());
  });
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, "0");
  CHECK(comes_unspun([&] { return ear.heard.size() >= 10; }));
  for (std::size_t i = 0; i < ear.heard.size(); ++i) CHECK(ear.heard[i] == std::to_string(i));
  CHECK(ear.heard.size() == 10);
}

TEST_CASE("what is latched in one process is handed over, and given to one that comes beside") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 10, true);
  std::set<const void*> sent, places;
  const auto latch = [&](const char* text) {
    auto message = talker.loan();
    message->data = text;
    sent.insert(message.get());
    talker.publish(std::move(message));
  };
  latch("0");
  std::size_t heard = 0;
  std::string latching;
  const auto callback = [&](const ros::MessageEvent<String const>& event) {
    ++heard;
    places.insert(event.getConstMessage().get());
    latching = event.getConnectionHeader().at("latching");
    CHECK(event.getPublisherName() == ros::this_node::getName());
  };
  auto first = node.subscribe<String>(topic, 10, callback);
  CHECK(comes([&] { return heard == 1; }));
  latch("1");
  CHECK(comes([&] { return heard == 2; }));
  auto second = node.subscribe<String>(topic, 10, callback);
  CHECK(comes([&] { return heard == 3; }));
  CHECK(places == sent);
  CHECK(latching == "1");
  CHECK(talker.serialised() == 0);
  // Plain ones, of the type and of any type: the last one, once, and then what comes.
  Words plain_heard, any_heard;
  ros::NodeHandle plain;
  auto third = plain.subscribe<std_msgs::String>(
      topic, 10, boost::function<void(const std_msgs::StringConstPtr&)>([&](const auto& s) {
        plain_heard.push_back(s->data);
      }));
  CHECK(comes([&] { return plain_heard == Words{"1"}; }));
  auto fourth = plain.subscribe<OtherString>(
      topic, 10,
      boost::function<void(const boost::shared_ptr<OtherString const>&)>(
          [&](const auto& any) { any_heard.emplace_back(any->data.data(), any->data.size()); }));
  CHECK(comes([&] { return any_heard == Words{"1"}; }));
  latch("2");
  CHECK(comes([&] {
    return heard == 5 && plain_heard == Words{"1", "2"} && any_heard == Words{"1", "2"};
  }));
  // One that subscribes anew has it from roscpp, and then what comes.
  first.shutdown();
  second.shutdown();
  Ear ear;
  auto again = node.subscribe<String>(topic, 10, ear.callback());
  latch("3");
  CHECK(comes([&] { return ear.heard == Words{"2", "3"}; }));
  CHECK(comes([&] { return plain_heard.size() == 3 && any_heard.size() == 3; }));
}

TEST_CASE("what has been latched goes with the publisher that latched it") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  Ear first, second;
  auto early = node.subscribe<String>(topic, 10, first.callback());
  auto other = node.advertise<String>(topic, 10);
  auto talker = node.advertise<String>(topic, 10, true);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, "latched");
  CHECK(comes([&] { return first.heard == Words{"latched"}; }));
  talker.shutdown();
  auto late = node.subscribe<String>(topic, 10, second.callback());
  say(other, "not latched");
  CHECK(comes([&] { return second.heard == Words{"not latched"}; }));
}

TEST_CASE("a thread that is held up in a subscriber's queue holds no other publisher up") {
  AtOnce queue;
  lot::ros::NodeHandle node, at_once;
  at_once.setCallbackQueue(&queue);
  const auto topic = fresh_topic();
  std::atomic<bool> is_at_work{false}, goes_on{false};
  auto holds_up = at_once.subscribe<String>(topic, 1000, [&](const String&) {
    is_at_work = true;
    comes_unspun([&] { return goes_on.load(); });
  });
  Ear ear;
  auto listener = node.subscribe<String>(topic, 1000, ear.callback());
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  std::thread first([&] { say(talker, "0"); });
  REQUIRE(comes_unspun([&] { return is_at_work.load(); }));
  // More than the publisher's queue: the subscriber's has room for them.
  for (int n = 1; n <= 200; ++n) say(talker, std::to_string(n).c_str());
  CHECK(comes([&] { return ear.heard.size() >= 200; }));
  goes_on = true;
  first.join();
  CHECK(comes([&] { return ear.heard.size() == 201; }));
  for (std::size_t n = 0; n < ear.heard.size(); ++n) CHECK(ear.heard[n] == std::to_string(n));
}

TEST_CASE("a queue that calls at once answers another process on the topic itself") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  const Elsewhere there(topic);
  auto talker = node.advertise<String>(topic, 10);
  AtOnce queue;
  lot::ros::NodeHandle at_once;
  at_once.setCallbackQueue(&queue);
  auto answers = node.advertise<String>(topic + "/heard", 10);
  std::mutex mutex;
  Words heard;
  auto listener = at_once.subscribe<String>(topic + "/heard", 100, [&](const String& s) {
    const std::string word(s.data.data(), s.data.size());
    {
      const std::lock_guard guard(mutex);
      heard.push_back(word);
    }
    if (word == "question") say(answers, "answer");
  });
  REQUIRE(comes([&] {
    return talker.getNumSubscribers() == 1 && listener.getNumPublishers() == 2 &&
           answers.getNumSubscribers() == 1;
  }));
  say(talker, "question");
  CHECK(comes([&] {
    const std::lock_guard guard(mutex);
    return heard == Words{"question", "answer"};
  }));
}

TEST_CASE("a plain one beside gets what is latched, and then what another publisher says") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  auto latching = node.advertise<String>(topic, 10, true);
  auto other = node.advertise<String>(topic, 10);
  Ear ear;
  auto listener = node.subscribe<String>(topic, 10, ear.callback());
  REQUIRE(comes([&] { return other.getNumSubscribers() == 1; }));
  say(latching, "latched");
  CHECK(comes([&] { return ear.heard == Words{"latched"}; }));
  Words plain_heard;
  auto plain = ros::NodeHandle().subscribe<std_msgs::String>(
      topic, 10, boost::function<void(const std_msgs::StringConstPtr&)>([&](const auto& s) {
        plain_heard.push_back(s->data);
      }));
  say(other, "and then");
  CHECK(comes([&] { return plain_heard == Words{"latched", "and then"}; }));
  CHECK(comes([&] { return ear.heard == Words{"latched", "and then"}; }));
  listener.shutdown();
  Ear again;
  auto anew = node.subscribe<String>(topic, 10, again.callback());
  say(other, "at last");
  CHECK(comes([&] { return !again.heard.empty() && again.heard.back() == "at last"; }));
  CHECK(comes([&] { return plain_heard.size() == 3; }));
}

// ---- callbacks on LOT's thread ------------------------------------------------------------------

TEST_CASE("LOT's thread calls callbacks at once, one after the other") {
  auto node = immediate();
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 1000);
  std::mutex mutex;
  std::set<std::thread::id> threads;
  Words heard;
  std::set<const void*> places;
  auto listener =
      node.subscribe<String>(topic, 1000, [&](const boost::shared_ptr<String const>& message) {
        const std::lock_guard guard(mutex);
        threads.insert(std::this_thread::get_id());
        heard.emplace_back(message->data.data(), message->data.size());
        places.insert(message.get());
      });
  REQUIRE(comes_unspun([&] { return talker.getNumSubscribers() == 1; }));
  Words said;
  std::set<const void*> sent;
  for (int n = 0; n < 500; ++n) {
    said.push_back(std::to_string(n));
    auto message = talker.loan();
    message->data = said.back().c_str();
    sent.insert(message.get());
    talker.publish(std::move(message));
  }
  CHECK(comes_unspun([&] {
    const std::lock_guard guard(mutex);
    return heard.size() == said.size();
  }));
  const std::lock_guard guard(mutex);
  CHECK(heard == said);
  CHECK(threads.size() == 1);
  CHECK(threads.count(std::this_thread::get_id()) == 0);
  CHECK(places == sent);
}

TEST_CASE("what comes by a link, and what is latched, is called at once, too") {
  auto node = immediate();
  const auto topic = fresh_topic();
  std::atomic<int> heard{0};
  std::atomic<bool> elsewhere{true};
  const auto here = std::this_thread::get_id();
  const auto callback = [&](const String&) {
    ++heard;
    if (std::this_thread::get_id() == here) elsewhere = false;
  };
  auto latching = node.advertise<String>(topic, 10, true);
  say(latching, "latched");
  auto first = node.subscribe<String>(topic, 10, callback);
  CHECK(comes_unspun([&] { return heard == 1; }));
  auto second = node.subscribe<String>(topic, 10, callback);  // of a topic that is read already
  CHECK(comes_unspun([&] { return heard == 2; }));

  const auto other = fresh_topic();
  ros::NodeHandle plain;
  auto talker = plain.advertise<std_msgs::String>(other, 10);
  auto third = node.subscribe<String>(other, 10, callback);
  REQUIRE(comes_unspun([&] { return talker.getNumSubscribers() == 1; }));
  talker.publish(std_msgs::String());
  CHECK(comes_unspun([&] { return heard == 3; }));
  CHECK(elsewhere);
}

TEST_CASE("a callback on LOT's thread opens and ends handles, while others do, and may throw") {
  auto node = immediate();
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 1000);
  std::atomic<int> called{0};
  std::atomic<int> inner{0};
  std::atomic<bool> ended{false};
  lot::ros::Subscriber own;
  own = node.subscribe<String>(topic, 1000, [&](const String& message) {
    const int n = ++called;
    if (n % 10 == 3) throw std::runtime_error("a mistake of the callback's");
    if (n % 10 == 4) throw 4;
    auto lot = immediate();
    auto another = lot.advertise<String>(topic + "/inner", 10);
    auto ear = lot.subscribe<String>(topic + "/outer", 10, [&](const String&) { ++inner; });
    another.publish(message);
    if (n == 200) {
      own.shutdown();
      ended = true;  // then only may this case destroy `own`
    }
  });
  REQUIRE(comes_unspun([&] { return talker.getNumSubscribers() == 1; }));
  std::atomic<bool> over{false};
  std::thread others([&] {
    auto lot = immediate();
    while (!over) {
      auto ear = lot.subscribe<String>(topic + "/inner", 10, [&](const String&) { ++inner; });
      auto outer = lot.subscribe<String>(topic + "/outer", 10, [](const String&) {});
      auto voice = lot.advertise<String>(topic + "/outer", 10);
      say(voice, "outer");
    }
  });
  for (int n = 0; n < 300 && called < 200; ++n) {
    say(talker, "go on");
    std::this_thread::sleep_for(2ms);
  }
  CHECK(comes_unspun([&] { return ended.load(); }));
  over = true;
  others.join();
  say(talker, "nobody hears that");
  std::this_thread::sleep_for(20ms);
  CHECK(called == 200);
}

TEST_CASE("no callback is at work on LOT's thread when its subscriber has been shut down") {
  auto node = immediate();
  for (int round = 0; round < 20; ++round) {
    const auto topic = fresh_topic();
    auto talker = node.advertise<String>(topic, 10);
    std::atomic<int> begun{0};
    std::atomic<int> ended{0};
    auto listener = node.subscribe<String>(topic, 10, [&](const String&) {
      ++begun;
      std::this_thread::sleep_for(5ms);
      ++ended;
    });
    REQUIRE(comes_unspun([&] { return talker.getNumSubscribers() == 1; }));
    for (int n = 0; n < 5; ++n) say(talker, "again");
    REQUIRE(comes_unspun([&] { return begun > 0; }));
    listener.shutdown();
    const int then = begun;
    CHECK(ended == then);
    std::this_thread::sleep_for(5ms);
    CHECK(begun == then);
  }
}

TEST_CASE("a callback on LOT's thread holds up no thread that ends or opens another topic") {
  auto node = immediate();
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 10, true);
  say(talker, "latched");
  std::atomic<int> begun{0};
  std::atomic<bool> waits{false};
  std::atomic<bool> done{false};
  std::atomic<int> in_time{0};
  const auto wait = [&](const String&) {
    ++begun;
    if (waits && comes_unspun([&] { return done.load(); })) ++in_time;
  };
  auto listener = node.subscribe<String>(topic, 10, wait);
  REQUIRE(comes_unspun([&] { return begun == 1; }));
  std::atomic<int> heard{0};
  auto voice = node.advertise<String>(topic + "/other", 10);
  auto other = node.subscribe<String>(topic + "/other", 10, [&](const String&) { ++heard; });
  REQUIRE(comes_unspun([&] { return voice.getNumSubscribers() == 1; }));
  waits = true;
  lot::ros::Subscriber second;
  for (const bool latched : {false, true}) {  // a message that comes; one that is there already
    done = false;
    const int before = begun;
    if (latched) {
      second = node.subscribe<String>(topic, 10, wait);
    } else {
      say(talker, "comes");
    }
    REQUIRE(comes_unspun([&] { return begun > before; }));
    for (int round = 0; round < 3; ++round) {
      other.shutdown();
      other = node.subscribe<String>(topic + "/other", 10, [&](const String&) { ++heard; });
    }
    done = true;
    CHECK(comes_unspun([&] { return in_time == begun - 1; }));
  }
  say(voice, "still here");
  CHECK(comes_unspun([&] { return heard == 1; }));
}

TEST_CASE("a frame that LOT's thread has yet to look at goes with its topic's last subscriber") {
  auto node = immediate();
  lot::ros::NodeHandle other;
  ros::NodeHandle plain;
  const auto topic = fresh_topic();
  std::atomic<bool> is_held{false};
  std::atomic<bool> goes_on{false};
  auto holder = node.subscribe<String>(topic, 10, [&](const String&) {
    is_held = true;
    (void)comes_unspun([&] { return goes_on.load(); });
    is_held = false;
  });
  auto talker = node.advertise<String>(topic, 10);
  auto voice = plain.advertise<std_msgs::String>(topic + "/plain", 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  for (int round = 0; round < 5; ++round) {
    goes_on = false;
    Ear ear;
    auto listener = other.subscribe<String>(topic + "/plain", 10, ear.callback());
    REQUIRE(comes([&] { return voice.getNumSubscribers() == 1; }));
    say(talker, "hold");
    REQUIRE(comes_unspun([&] { return is_held.load(); }));
    voice.publish(std_msgs::String());
    std::this_thread::sleep_for(20ms);  // the frame is on its way
    listener.shutdown();
    goes_on = true;
    CHECK(comes_unspun([&] { return !is_held; }));
    CHECK(comes([&] { return voice.getNumSubscribers() == 0; }));
    CHECK(ear.heard.empty());
  }
}

TEST_CASE("the last subscriber of a process ends while another one's callback is at work") {
  auto node = immediate();
  ros::NodeHandle plain;
  const auto topic = fresh_topic();
  auto talker = plain.advertise<std_msgs::String>(topic, 10);
  std::mutex mutex;
  std::atomic<bool> begun{false};
  std::atomic<bool> done{false};
  lot::ros::Subscriber once;
  once = node.subscribe<String>(topic, 10, [&](const String&) {
    once.shutdown();
    begun = true;
    comes_unspun([] { return false; }, 100ms);
    {
      const std::lock_guard guard(mutex);
      auto again = node.subscribe<String>(topic + "/other", 10, [](const String&) {});
    }
    done = true;  // last: no thread waits for a callback that has ended itself; the mutex goes then
  });
  auto other = node.subscribe<String>(topic + "/other", 10, [](const String&) {});
  REQUIRE(comes_unspun([&] { return talker.getNumSubscribers() == 1; }));
  talker.publish(std_msgs::String());
  REQUIRE(comes_unspun([&] { return begun.load(); }));
  {
    const std::lock_guard guard(mutex);
    other.shutdown();
  }
  CHECK(comes_unspun([&] { return done.load(); }));
}

TEST_CASE("a short queue loses nothing to LOT's thread, and is a bound where that is slow") {
  auto node = immediate();
  const auto topic = fresh_topic();
  auto talker = node.advertise<String>(topic, 100);
  std::atomic<int> heard{0};
  auto listener = node.subscribe<String>(topic, 2, [&](const String&) { ++heard; });
  REQUIRE(comes_unspun([&] { return talker.getNumSubscribers() == 1; }));
  for (int n = 0; n < 90; ++n) say(talker, "burst");
  CHECK(comes_unspun([&] { return heard == 90; }));

  const auto other = fresh_topic();
  ros::NodeHandle plain;
  auto voice = plain.advertise<std_msgs::String>(other, 1000);
  std::atomic<int> called{0};
  std::atomic<bool> last{false};
  auto slow = node.subscribe<String>(other, 1, [&](const String& message) {
    std::this_thread::sleep_for(5ms);
    ++called;
    last = message.data == "last";
  });
  REQUIRE(comes_unspun([&] { return voice.getNumSubscribers() == 1; }));
  std_msgs::String message;
  for (int n = 0; n < 500; ++n) voice.publish(message);
  message.data = "last";
  voice.publish(message);
  CHECK(comes_unspun([&] { return last.load(); }));
  CHECK(called < 400);
}

TEST_CASE("what is not LOT's goes to roscpp's queue, where LOT's thread calls callbacks") {
  auto node = immediate();
  const auto here = std::this_thread::get_id();
  int ticks = 0;
  bool is_here = true;
  ros::Timer timer;
  timer = node.createTimer(ros::Duration(0.002), [&](const ros::TimerEvent&) {
    ++ticks;
    is_here = is_here && std::this_thread::get_id() == here;
    if (ticks == 5) timer.stop();  // needs the lock under which it was added
  });
  const auto topic = fresh_topic();
  auto talker = node.advertise<std_msgs::String>(topic, 10);
  int heard = 0;
  auto listener = node.subscribe<std_msgs::String>(topic, 10, [&](const std_msgs::String&) {
    ++heard;
    is_here = is_here && std::this_thread::get_id() == here;
  });
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  talker.publish(std_msgs::String());
  CHECK(comes([&] { return ticks == 5 && heard == 1; }));
  CHECK(is_here);
}

int main(int argc, char** argv) {
  if (argc > 2 && std::string(argv[1]) == "--echo") return echo(argc, argv);
  doctest::Context context(argc, argv);
  if (argc > 1 && std::string(argv[1]) == "-ltc") return context.run();  // needs no master
  ros::init(argc, argv, "handles");
  ros::NodeHandle keeps_ros;
  const int result = context.run();
  ros::shutdown();
  return result;
}
