// SPDX-License-Identifier: Apache-2.0

// The documents that `lot` writes, judged by its JSON Schema, through a validator that is not ours.

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "scene.hpp"
#include "support/janitor.hpp"
#include "support/scratch.hpp"
#include "support/users.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// Keeps documents, and has them judged.
class Documents {
 public:
  const Json& add(const std::vector<std::string>& words) {
    const Ran ran = run_lot(words);
    CHECK(ran.exit != 2);
    if (ran.out.empty()) MESSAGE(ran.err);
    return all_.emplace_back(ran.json());
  }

  /// Those of a verb that writes one a line.
  void add_lines(const std::vector<std::string>& words) {
    std::istringstream lines(run_lot(words).out);
    for (std::string line; std::getline(lines, line);) all_.push_back(Json::parse(line));
  }
  std::size_t size() const { return all_.size(); }

  /// How many complaints there are: 0 is well, else python says them.
  int judge(const std::string& option = "") const {
    const std::string path = room_.path() + "/documents";
    {
      std::ofstream file(path);
      for (const auto& document : all_) file << document.dump() << '\n';
    }
    const int status =
        std::system((LOT_PYTHON " " LOT_JUDGE " " LOT_SCHEMA " " + option + " < " + path).c_str());
    std::filesystem::remove(path);
    return status;
  }

 private:
  Room room_;
  std::vector<Json> all_;
};

void make_other_version(const lot::EngineOptions& options) {
  Actor(options, "actor").kill9();
  const int file = open((options.directory + "/" + options.segment).c_str(), O_RDWR | O_CLOEXEC);
  const std::uint32_t other = 999;
  REQUIRE(pwrite(file, &other, sizeof(other), 8) == sizeof(other));
  close(file);
}

}  // namespace

TEST_SUITE_BEGIN("schema");

TEST_CASE("documents of lot ls, top and who with all that there is fit the schema") {
  const Watchdog watchdog(120);
  const Scene scene;
  Documents documents;
  const Json ls = documents.add(on(scene.options, {"ls", "--json", "--interval", "1"}));
  CHECK(!ls.at("segments").at(0).at("topics").at(0).at("publishers").empty());
  const Json top = documents.add(on(scene.options, {"top", "--json", "--interval", "1"}));
  CHECK(!top.at("segments").at(0).at("topics").empty());
  CHECK(!top.at("segments").at(0).at("processes").empty());
  documents.add(on(scene.options, {"who", "--json"}));
  const Json who = documents.add(on(scene.options, {"who", "--json", "--all"}));
  for (const char* list : {"messages", "behind", "waiting"}) {
    CHECK(!who.at("segments").at(0).at(list).empty());
  }
  CHECK(documents.judge() == 0);
  CHECK(documents.judge("--self-test") == 0);
}

TEST_CASE("the documents of what lot can not look into, and of nothing, fit the schema") {
  const Watchdog watchdog(120);
  const Room room;
  Documents documents;
  for (const char* verb : {"ls", "top", "who"}) {
    documents.add({verb, "--json", "--dir", room.path()});
    documents.add(on(room.options(), {verb, "--json"}));
  }
  make_other_version(room.options("other"));
  if (can_be_another_user()) {
    { const lot::ShmEngine engine(room.options("untrusted")); }
    Actor(room.options("untrusted"), "actor").kill9();
    REQUIRE(chown((room.path() + "/untrusted").c_str(), 65532, 65532) == 0);
  }
  for (const char* verb : {"ls", "top", "who"}) {
    const Json seen = documents.add({verb, "--json", "--dir", room.path()});
    CHECK(seen.at("segments").at(0).at("condition") == "damaged");
    CHECK(seen.at("exit") == 3);
  }
  CHECK(documents.judge() == 0);
}

TEST_CASE("the documents of lot echo and lot pub fit the schema") {
  const Watchdog watchdog(120);
  struct Note {
    int number;
  };
  const Room room;
  Documents documents;
  lot::ShmEngine engine(room.options());
  lot::PusherOptions stamping;
  stamping.stamp = true;
  auto pusher = engine.advertise<Note>("/stamped", stamping);
  auto plain = engine.advertise<Note>("/plain");
  const auto reader = engine.subscribe<Note>("/plain");
  CHECK(pusher.push(pusher.loan(Note{1})) == lot::Status::Ok);
  CHECK(plain.push(plain.loan(Note{1})) == lot::Status::Ok);
  documents.add(on(room.options(), {"pub", "--json", "/plain", "{number: 3}"}));
  documents.add(on(room.options(), {"pub", "--json", "/plain", "{numbr: 3}"}));
  documents.add(on(room.options(), {"pub", "--json", "/none", "{}"}));
  CHECK(documents.judge("--self-test") == 0);
  for (const char* topic : {"/stamped", "/plain"}) {  // a message may be anything
    documents.add(on(room.options(), {"echo", "--json", "--envelope", "--count", "1", topic}));
  }
  CHECK(documents.judge() == 0);
}

TEST_CASE("the documents of lot record, info and play fit the schema") {
  const Watchdog watchdog(120);
  struct Note {
    int number;
  };
  struct Chained {
    lot::ShmRef<const Note> note;
  };
  const Room room;
  const Directory directory;
  Documents documents;
  lot::ShmEngine engine(room.options());
  auto notes = engine.advertise<Note>("/notes");
  auto chained = engine.advertise<Chained>("/chained");
  CHECK(notes.push(notes.loan(Note{1})) == lot::Status::Ok);
  const std::string file = directory.file();
  const Json recorded = documents.add(
      on(room.options(), {"record", "--json", "--all", "--duration", "0.3", "-o", file}));
  CHECK(recorded.at("topics").size() == 1);
  CHECK(recorded.at("refused").size() == 1);
  documents.add({"info", "--json", file, directory.file("none")});
  write_file(directory.file("cut"), std::string_view(read_file(file)).substr(0, 700));
  documents.add({"info", "--json", directory.file("cut")});
  documents.add(on(room.options(), {"play", "--json", file}));
  auto other = engine.advertise<Chained>("/other");
  documents.add(on(room.options(), {"play", "--json", file, "--remap", "/notes:=/other"}));
  documents.add(on(room.options(), {"play", "--json", directory.file("none")}));  // at its begin
  documents.add(on(room.options(), {"record", "--json", "--all", "-o", file}));   // as well
  CHECK(documents.judge() == 0);
  CHECK(documents.judge("--self-test") == 0);
}

TEST_CASE("the documents of lot hz, bw and delay fit the schema, also where nothing comes") {
  const Watchdog watchdog(120);
  const Room room;
  Documents documents;
  Steps ready;
  const Child publisher([&] {
    lot::ShmEngine engine(room.options());
    auto notes = engine.advertise<Letter>("/notes", {lot::Policy::Overwrite, 4, {}});
    lot::PusherOptions stamping;
    stamping.stamp = true;
    auto stamped = engine.advertise<Letter>("/stamped", stamping);
    ready.tell();
    for (;; usleep(2000)) {
      (void)notes.push(notes.loan());
      (void)stamped.push(stamped.loan());
    }
  });
  REQUIRE(ready.next() == '.');
  for (const char* verb : {"hz", "bw", "delay"}) {
    for (const char* topic : {"/notes", "/stamped", "/none"}) {
      CAPTURE(std::string(verb));
      CAPTURE(std::string(topic));
      const std::size_t before = documents.size();
      documents.add_lines(
          on(room.options(), {verb, topic, "--json", "--interval", "100", "--duration", "0.35"}));
      CHECK(documents.size() >= before + 2);
    }
  }
  CHECK(documents.judge() == 0);
  CHECK(documents.judge("--self-test") == 0);
}

TEST_CASE("the document of lot doctor fits the schema") {
  const Watchdog watchdog(120);
  const Room room;
  Documents documents;
  const Actor actor(room.options("s"), "actor");
  documents.add({"doctor", "--json", "--dir", room.path()});
  documents.add({"doctor", "--json", "--dir", room.path() + "/none"});
  CHECK(documents.judge() == 0);
  CHECK(documents.judge("--self-test") == 0);
}

TEST_CASE("the documents of lot clean fit the schema, whatever it did") {
  const Watchdog watchdog(120);
  const Room room;
  Documents documents;
  documents.add({"clean", "--json", "--dir", room.path()});
  std::ofstream(room.path() + "/doubtful.lock");
  std::filesystem::permissions(room.path() + "/doubtful.lock", std::filesystem::perms(0600));
  Actor(room.options("gone"), "actor").kill9();
  {
    auto options = room.options("items");
    options.persist = true;
    lot::ShmEngine engine(options);
    CHECK(engine.queue<std::uint64_t>("jobs").put(1) == lot::Status::Ok);
  }
  Actor publisher(room.options("alive"), "publisher");
  Actor victim(room.options("alive"), "victim");
  {
    struct Frame {
      lot::ShmVector<char> data;
    };
    lot::ShmEngine engine(room.options("alive"));
    auto pusher = engine.advertise<Frame>("/frames", {lot::Policy::Overwrite, 2, {}});
    pusher.loan()->data.resize(4 << 20);
  }
  stop(publisher.child());  // so that no process reaps the dead one
  victim.kill9();
  for (const char* option : {"--dry-run", "--json", "--with-items"}) {
    const Json did = documents.add({"clean", "--json", option, "--dir", room.path()});
    CHECK(!did.at("left_alone").empty());
    if (std::string(option) == "--json") {
      for (const char* list : {"removed", "reaped", "given_back", "in_use"}) {
        CAPTURE(list);
        CHECK(!did.at(list).empty());
      }
    }
  }
  publisher.child().send(SIGCONT);
  CHECK(documents.judge() == 0);
}

TEST_SUITE_END();
