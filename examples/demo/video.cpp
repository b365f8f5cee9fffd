// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <lot/lot.hpp>

#include "command.hpp"
#include "frame.hpp"
#include "screen.hpp"

namespace demo {
namespace {

using namespace std::chrono_literals;

struct Video {
  std::uint32_t width = 0, height = 0;
  std::string rate;
  std::size_t frame_bytes() const { return std::size_t{3} * width * height; }
};

Video probe(const std::string& file) {
  Command command({"ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries",
                   "stream=width,height,avg_frame_rate", "-of", "json", file});
  const std::string text = command.read_all();
  command.finish();
  const Json streams = Json::parse(text).value("streams", Json::array());
  if (streams.empty()) throw std::runtime_error(file + " has no video stream");
  Video video;
  video.width = streams[0].at("width").get<std::uint32_t>();
  video.height = streams[0].at("height").get<std::uint32_t>();
  video.rate = streams[0].value("avg_frame_rate", "?");
  return video;
}

/// Every frame as it is, in whichever form the caller wants it.
std::vector<std::string> decode(const std::string& file, const std::vector<std::string>& format) {
  std::vector<std::string> words{"ffmpeg",    "-v",          "error",    "-nostdin",
                                 "-i",        file,          "-map",     "0:v:0",
                                 "-fps_mode", "passthrough", "-pix_fmt", "bgr24"};
  words.insert(words.end(), format.begin(), format.end());
  words.emplace_back("-");
  return words;
}

/// The hashes that ffmpeg itself computes, in order.
std::vector<std::uint32_t> reference_hashes(const std::string& file) {
  Command command(decode(file, {"-f", "framehash", "-hash", "adler32"}));
  std::istringstream text(command.read_all());
  command.finish();
  std::vector<std::uint32_t> hashes;
  for (std::string line; std::getline(text, line);) {
    if (line.empty() || line[0] == '#') continue;
    hashes.push_back(
        static_cast<std::uint32_t>(std::stoul(line.substr(line.rfind(',') + 1), nullptr, 16)));
  }
  return hashes;
}

}  // namespace

/// Publishes a video as fast as the slowest consumer allows: nothing is lost.
int video_camera(const Settings& settings) {
  Control control(true);
  const Video video = probe(settings.input);
  lot::ShmEngine engine(settings.engine());
  lot::PusherOptions options;
  options.policy = lot::Policy::Block;
  options.depth = settings.depth;
  options.block_for = 20s;
  auto pusher = engine.advertise<Frame>(kTopic, options);
  say("ready");
  if (!pusher.wait_for_readers(kConsumers, 10s)) {
    throw std::runtime_error("the consumers have not come");
  }
  const auto begin = Clock::now();
  const auto push = [&](lot::ShmUniquePtr<Frame>&& frame) {
    if (pusher.push(std::move(frame)) != lot::Status::Ok) {
      throw std::runtime_error("a consumer does not read");
    }
  };
  std::uint32_t number = 0;
  Command ffmpeg(decode(settings.input, {"-f", "rawvideo"}));
  for (bool more = true; more && !control.stop();) {
    lot::ShmUniquePtr<Frame> frame = pusher.loan();
    frame->data.resize(video.frame_bytes());
    const std::size_t bytes = ffmpeg.read(frame->data.data(), frame->data.size());
    more = bytes == frame->data.size();
    if (!more && bytes != 0) throw std::runtime_error("the video ends within a frame");
    if (!more) frame->data.clear();
    frame->head = make_head(1, number, !more);
    push(std::move(frame));
    number += more ? 1 : 0;
    if (number % settings.report_every == 0) say("at", {{"frames", number}});
  }
  ffmpeg.finish();
  const std::chrono::duration<double> seconds = Clock::now() - begin;
  say("done", {{"sent", number}, {"seconds", seconds.count()}});
  return 0;
}

bool video(const Settings& settings) {
  const Video video = probe(settings.input);
  std::printf("%s: %u x %u, %s frames per second; as bgr24 each has %zu bytes\n",
              settings.input.c_str(), video.width, video.height, video.rate.c_str(),
              video.frame_bytes());
  Family family;
  Settings consumer = settings;
  consumer.role = "ring-consumer";
  consumer.hash = true;
  for (unsigned i = 1; i <= kConsumers; ++i) {
    consumer.number = i;
    family.start(consumer_name(i), consumer);
  }
  Settings camera = settings;
  camera.role = "video-camera";
  family.start("camera", camera);
  {
    Progress progress("video");
    family.on_report = [&] { progress.show(how_far(family)); };
    family.wait_until(
        "all frames cross",
        [&] {
          bool done = family["camera"].has_said("done");
          for (unsigned i = 1; i <= kConsumers; ++i) {
            done &= family[consumer_name(i)].has_said("done");
          }
          return done;
        },
        24h);
    family.on_report = nullptr;
  }
  family.dismiss();
  const Json& sent = family["camera"].said["done"];
  std::printf("published at full speed: %.0f frames per second\n",
              sent.at("sent").get<double>() / sent.at("seconds").get<double>());

  const std::vector<std::uint32_t> expected = reference_hashes(settings.input);
  bool equal = !expected.empty() && sent.at("sent").get<std::size_t>() == expected.size();
  std::uint64_t lost = 0;
  for (unsigned i = 1; i <= kConsumers; ++i) {
    const Json& done = family[consumer_name(i)].said["done"];
    const auto hashes = done.at("hashes").get<std::vector<std::uint32_t>>();
    lost += done.at("lost").get<std::uint64_t>() +
            (expected.size() - std::min(expected.size(), hashes.size()));
    if (hashes == expected) continue;
    equal = false;
    const auto differs =
        std::mismatch(hashes.begin(), hashes.end(), expected.begin(), expected.end());
    std::printf("consumer %u: %zu frames; the first that differs is number %td\n", i, hashes.size(),
                differs.first - hashes.begin());
  }
  std::printf("%zu frames, %u consumers, %s `ffmpeg -f framehash -hash adler32`, %llu lost\n",
              expected.size(), kConsumers,
              equal ? "all hashes equal to those of" : "NOT ALL HASHES EQUAL to those of",
              static_cast<unsigned long long>(lost));
  const auto files = files_of(family[consumer_name(1)].said["ready"].at("path").get<std::string>());
  for (const std::string& name : files) std::printf("left behind: %s\n", name.c_str());
  return equal && lost == 0 && files.empty();
}

}  // namespace demo
