// SPDX-License-Identifier: Apache-2.0
/// Nodelets that know nothing of LOT.
#include <boost/make_shared.hpp>

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
        "image", 600, [this](const sensor_msgs::ImageConstPtr& image) { tally_.add(*image); });
    timer_ = getNodeHandle().createTimer(
        ros::Duration(0.25), [this](const auto&) { tally_.tell(getPrivateNodeHandle()); });
    getPrivateNodeHandle().setParam("ready", true);
  }

  Tally tally_;
  ros::Subscriber in_;
  ros::Timer timer_;
};

}  // namespace lot_test

PLUGINLIB_EXPORT_CLASS(lot_test::PlainViewer, nodelet::Nodelet)
