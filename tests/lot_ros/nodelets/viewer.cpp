// SPDX-License-Identifier: Apache-2.0
/// A viewer as a nodelet. Built twice, for two libraries: LOT_TEST_VIEWER is the class's name.
#include "nodelets.hpp"

namespace lot_test {

class LOT_TEST_VIEWER final : public nodelet::Nodelet {
 public:
  ~LOT_TEST_VIEWER() override {
    in_.shutdown();
    timer_.stop();
    tally_.tell(getPrivateNodeHandle());
  }

 private:
  void onInit() override {
    in_ = lot::ros::NodeHandle(getNodeHandle())
              .subscribe<LotImage>("image", 600,
                                   [this](const LotImage& image) { tally_.add(image); });
    timer_ = getNodeHandle().createTimer(
        ros::Duration(0.25), [this](const auto&) { tally_.tell(getPrivateNodeHandle()); });
    getPrivateNodeHandle().setParam("ready", true);
  }

  Tally tally_;
  lot::ros::Subscriber in_;
  ros::Timer timer_;
};

}  // namespace lot_test

PLUGINLIB_EXPORT_CLASS(lot_test::LOT_TEST_VIEWER, nodelet::Nodelet)
