// SPDX-License-Identifier: Apache-2.0
/// Nodelets that know nothing of LOT.
#include <cstdint>
#include <map>
#include <mutex>

#include "nodelets.hpp"

namespace lot_test {

class PlainViewer final : public nodelet::Nodelet {
 public:
  ~PlainViewer() override {
    in_.shutdown();
    timer_.stop();
  }

 private:
  void onInit() override {
    in_ = getNodeHandle().subscribe<sensor_msgs::Image>(
        "image", 600, [this](const sensor_msgs::ImageConstPtr& image) {
          if (is_apart(image)) ++apart_;
          tally_.add(*image);
        });
    timer_ = getNodeHandle().createTimer(ros::Duration(0.25), [this](const auto&) {
      getPrivateNodeHandle().setParam("apart", apart_);
      tally_.tell(getPrivateNodeHandle());
    });
    getPrivateNodeHandle().setParam("ready", true);
  }

  /// Whether the process's other viewer has had it elsewhere. What the first one has got is kept
  /// until then, so that no other image lies there.
  static bool is_apart(const sensor_msgs::ImageConstPtr& image) {
    static std::mutex mutex;
    static std::map<std::uint32_t, sensor_msgs::ImageConstPtr> seen;
    const std::lock_guard guard(mutex);
    const auto [first, is_first] = seen.emplace(image->height, image);
    if (is_first) return false;
    const bool is_apart = first->second != image;
    seen.erase(first);
    return is_apart;
  }

  int apart_ = 0;  ///< images that the other viewer had elsewhere
  Tally tally_;
  ros::Subscriber in_;
  ros::Timer timer_;
};

}  // namespace lot_test

PLUGINLIB_EXPORT_CLASS(lot_test::PlainViewer, nodelet::Nodelet)
