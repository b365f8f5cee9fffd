// SPDX-License-Identifier: Apache-2.0
#include <iterator>
#include <utility>

#include "transport.hpp"

namespace ab {
namespace {

#ifndef LOT_AB_FASTDDS
constexpr const char* kNoFastdds = "was not found when this was built; install libfastrtps-dev";
#endif
#ifndef LOT_AB_ROS
constexpr const char* kNoRos =
    "was not found when this was built; install libroscpp-dev and libsensor-msgs-dev";
#endif

std::vector<Transport> all() {
  std::vector<Transport> every;
  for (auto* const of_file : {
           lot_transports,
           lot2021_transports,
           socket_transports,
           udp_transports,
           tzc_transports,
           intra_transports,
#ifdef LOT_AB_ICEORYX
           iceoryx_transports,
#endif
#ifdef LOT_AB_FASTDDS
           fastdds_transports,
#endif
#ifdef LOT_AB_ROS
           ros_transports,
#endif
           floor_transports,
       }) {
    std::vector<Transport> some = of_file();
    every.insert(every.end(), std::make_move_iterator(some.begin()),
                 std::make_move_iterator(some.end()));
  }
  return every;
}

}  // namespace

const std::vector<Transport>& transports() {
  static const std::vector<Transport> every = all();
  return every;
}

const Transport* find_transport(const std::string& name) {
  for (const Transport& each : transports()) {
    if (each.name == name) return &each;
  }
  return nullptr;
}

const std::vector<Missing>& missing_transports() {
  static const std::vector<Missing> missing{
#ifndef LOT_AB_ICEORYX
      {"iceoryx", "was not found when this was built; install libiceoryx-posh-dev"},
#endif
#ifndef LOT_AB_FASTDDS
      {"fastdds", kNoFastdds},
      {"fastdds-loan", kNoFastdds},
#endif
#ifndef LOT_AB_ROS
      {"ros-lot", kNoRos},
      {"ros-lot-immediate", kNoRos},
      {"ros-lot-mutex", kNoRos},
      {"ros-tcp", kNoRos},
      {"ros-tcp-nodelay", kNoRos},
      {"ros-udp", kNoRos},
      {"ros-intra", kNoRos},
      {"ros-tzc", kNoRos},
      {"floor-ros", kNoRos},
#endif
  };
  return missing;
}

}  // namespace ab
