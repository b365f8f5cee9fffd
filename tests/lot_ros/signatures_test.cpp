// SPDX-License-Identifier: Apache-2.0

// Callbacks in every shape that roscpp takes. What subscribes by LOT is a lot::ros::Subscriber,
// which a ros::Subscriber is not: each line compiles only where LOT's overload has been chosen.

#include <functional>
#include <map>
#include <string>
#include <vector>

#include <boost/bind/bind.hpp>
#include <boost/function.hpp>
#include <boost/make_shared.hpp>
#include <doctest/doctest.h>

#include "handles.hpp"

namespace {

using lot::ros::Subscriber;
using lot::ros::test::comes;
using lot::ros::test::fresh_topic;
using lot::ros::test::say;
using lot::ros::test::String;
using Pointer = boost::shared_ptr<String const>;
using Event = ros::MessageEvent<String const>;
using boost::placeholders::_1;

constexpr const char* kSaid = "to everybody";
std::map<std::string, int> calls;  // of those that got what was said

void note(const char* shape, const String& message) {
  if (message.data == kSaid) ++calls[shape];
}
void note_and_change(const char* shape, String& message) {
  note(shape, message);
  message.data = "changed";  // its own copy
}

void reference(const String& s) { note("reference", s); }
void value(String s) { note_and_change("value", s); }
void pointer(const Pointer& s) { note("pointer", *s); }
void pointer_value(Pointer s) { note("pointer_value", *s); }
void to_change(const boost::shared_ptr<String>& s) { note_and_change("to_change", *s); }
void to_change_value(boost::shared_ptr<String> s) { note_and_change("to_change_value", *s); }
void event(const Event& e) { note("event", *e.getMessage()); }
void event_to_change(const ros::MessageEvent<String>& e) {
  note_and_change("event_to_change", *e.getMessage());
}
void shared(const lot::ShmSharedPtr<const String>& s) { note("shared", *s); }
void shared_value(lot::ShmSharedPtr<const String> s) { note("shared_value", *s); }

struct Object {
  void reference(const String& s) { note("member: reference", s); }
  void looks(const String& s) const { note("member: looks", s); }
  void pointer(const Pointer& s) { note("member: pointer", *s); }
  void looks_at_pointer(const Pointer& s) const { note("member: looks_at_pointer", *s); }
  void event(const Event& e) { note("member: event", *e.getMessage()); }
  void shared(const lot::ShmSharedPtr<const String>& s) { note("member: shared", *s); }
};

/// So many calls of each shape, in the end.
bool all_are(std::map<std::string, int> expected) {
  return comes([&] { return calls == expected; });
}

}  // namespace

TEST_CASE("functions of every shape are called, with the type said or deduced") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  calls.clear();
  std::vector<Subscriber> subscribers;
  subscribers.push_back(node.subscribe(topic, 10, value));
  subscribers.push_back(node.subscribe(topic, 10, to_change));
  subscribers.push_back(node.subscribe(topic, 10, to_change_value));
  subscribers.push_back(node.subscribe(topic, 10, event_to_change));
  subscribers.push_back(node.subscribe(topic, 10, reference));
  subscribers.push_back(node.subscribe(topic, 10, pointer));
  subscribers.push_back(node.subscribe(topic, 10, pointer_value));
  subscribers.push_back(node.subscribe(topic, 10, event));
  subscribers.push_back(node.subscribe(topic, 10, shared));
  subscribers.push_back(node.subscribe(topic, 10, shared_value));
  subscribers.push_back(node.subscribe<String>(topic, 10, &value));
  subscribers.push_back(node.subscribe<String>(topic, 10, &to_change));
  subscribers.push_back(node.subscribe<String>(topic, 10, &to_change_value));
  subscribers.push_back(node.subscribe<String>(topic, 10, &event_to_change));
  subscribers.push_back(node.subscribe<String>(topic, 10, &reference));
  subscribers.push_back(
      node.subscribe<String>(topic, 10, &pointer, ros::TransportHints().tcpNoDelay()));
  subscribers.push_back(node.subscribe<String>(topic, 10, &pointer_value));
  subscribers.push_back(node.subscribe<String>(topic, 10, &event));
  subscribers.push_back(node.subscribe<String>(topic, 10, &shared));
  subscribers.push_back(node.subscribe<String>(topic, 10, &shared_value));
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, kSaid);
  CHECK(all_are({{"value", 2},
                 {"to_change", 2},
                 {"to_change_value", 2},
                 {"event_to_change", 2},
                 {"reference", 2},
                 {"pointer", 2},
                 {"pointer_value", 2},
                 {"event", 2},
                 {"shared", 2},
                 {"shared_value", 2}}));
  CHECK(talker.serialised() == 0);
}

TEST_CASE("members of every shape are called, of objects that are owned or not") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  calls.clear();
  Object object;
  auto owned = boost::make_shared<Object>();
  std::vector<Subscriber> subscribers;
  subscribers.push_back(node.subscribe(topic, 10, &Object::reference, &object));
  subscribers.push_back(node.subscribe(topic, 10, &Object::looks, &object));
  subscribers.push_back(node.subscribe(topic, 10, &Object::pointer, &object));
  subscribers.push_back(node.subscribe(topic, 10, &Object::looks_at_pointer, &object));
  subscribers.push_back(node.subscribe(topic, 10, &Object::event, &object));
  subscribers.push_back(node.subscribe(topic, 10, &Object::shared, &object));
  subscribers.push_back(node.subscribe(topic, 10, &Object::reference, owned));
  subscribers.push_back(node.subscribe(topic, 10, &Object::looks, owned));
  subscribers.push_back(node.subscribe(topic, 10, &Object::pointer, owned));
  subscribers.push_back(node.subscribe(topic, 10, &Object::looks_at_pointer, owned));
  subscribers.push_back(node.subscribe(topic, 10, &Object::event, owned));
  subscribers.push_back(node.subscribe(topic, 10, &Object::shared, owned));
  subscribers.push_back(node.subscribe<const String&>(topic, 10, &Object::reference, &object));
  subscribers.push_back(node.subscribe<String>(topic, 10, &Object::pointer, &object));
  subscribers.push_back(node.subscribe<String>(topic, 10, &Object::looks_at_pointer, owned));
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, kSaid);
  CHECK(all_are({{"member: reference", 3},
                 {"member: looks", 2},
                 {"member: pointer", 3},
                 {"member: looks_at_pointer", 3},
                 {"member: event", 2},
                 {"member: shared", 2}}));
  CHECK(talker.serialised() == 0);
  calls.clear();
  owned.reset();  // its callbacks end with it
  say(talker, kSaid);
  CHECK(all_are({{"member: reference", 2},
                 {"member: looks", 1},
                 {"member: pointer", 2},
                 {"member: looks_at_pointer", 1},
                 {"member: event", 1},
                 {"member: shared", 1}}));
}

TEST_CASE("whatever can be called is called, as long as what it belongs to is there") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  calls.clear();
  Object object;
  auto tracked = boost::make_shared<int>(0);
  const boost::function<void(const Pointer&)> by_pointer = pointer;
  const boost::function<void(const String&)> by_reference = reference;
  std::vector<Subscriber> subscribers;
  subscribers.push_back(node.subscribe<String>(topic, 10, by_pointer));
  subscribers.push_back(node.subscribe<String>(topic, 10, by_pointer, tracked));
  subscribers.push_back(node.subscribe<String>(topic, 10, by_reference));
  subscribers.push_back(node.subscribe<String, const String&>(topic, 10, by_reference));
  subscribers.push_back(node.subscribe<String, const String&>(topic, 10, by_reference, tracked));
  subscribers.push_back(node.subscribe<String, const Pointer&>(topic, 10, by_pointer, tracked,
                                                               ros::TransportHints()));
  subscribers.push_back(node.subscribe<String>(topic, 10, boost::bind(pointer, _1)));
  subscribers.push_back(
      node.subscribe<String>(topic, 10, boost::bind(&Object::pointer, &object, _1)));
  subscribers.push_back(
      node.subscribe<String>(topic, 10, std::function<void(const String&)>(reference)));
  subscribers.push_back(node.subscribe<String>(topic, 10, [](const Pointer& s) { pointer(s); }));
  subscribers.push_back(node.subscribe<String>(topic, 10, [](const auto& s) { pointer(s); }));
  auto talker = node.advertise<String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  say(talker, kSaid);
  CHECK(all_are({{"pointer", 6}, {"reference", 4}, {"member: pointer", 1}}));
  CHECK(talker.serialised() == 0);
  calls.clear();
  tracked.reset();
  say(talker, kSaid);
  CHECK(all_are({{"pointer", 4}, {"reference", 3}, {"member: pointer", 1}}));
}

TEST_CASE("messages that are no lot::ros::Message are roscpp's own") {
  lot::ros::NodeHandle node;
  const auto topic = fresh_topic();
  int heard = 0;
  struct Plain {
    void hears(const std_msgs::String::ConstPtr&) { ++n; }
    int n = 0;
  } plain;
  ros::Subscriber function =
      node.subscribe<std_msgs::String>(topic, 10,
                                       boost::function<void(const std_msgs::String::ConstPtr&)>(
                                           [&](const std_msgs::String::ConstPtr&) { ++heard; }));
  ros::Subscriber member = node.subscribe(topic, 10, &Plain::hears, &plain);
  ros::Publisher talker = node.advertise<std_msgs::String>(topic, 10);
  REQUIRE(comes([&] { return talker.getNumSubscribers() == 1; }));
  talker.publish(std_msgs::String());
  CHECK(comes([&] { return heard == 1 && plain.n == 1; }));
}
