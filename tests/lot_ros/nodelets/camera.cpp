// SPDX-License-Identifier: Apache-2.0
/// Cameras as nodelets: images with a number, and the place where their bytes lie. One makes them
/// in shared memory; the other makes standard ones, and publishes them by pointer.
#include <cstddef>
#include <utility>

#include <boost/make_shared.hpp>

#include "nodelets.hpp"

namespace lot_test {

template <class Maker>
class AnyCamera : public nodelet::Nodelet {
 public:
  ~AnyCamera() override { timer_.stop(); }

 private:
  void onInit() override {
    const auto own = getPrivateNodeHandle();
    own.param("count", count_, count_);
    own.param("bytes", bytes_, bytes_);
    out_ = lot::ros::NodeHandle(getNodeHandle()).advertise<LotImage>("image", 30);
    timer_ =
        getNodeHandle().createTimer(ros::Duration(kPeriod), [this](const auto&) { publish(); });
    own.setParam("ready", true);
  }

  void publish() {
    bool go = false;
    if (number_ == 0 && (!getPrivateNodeHandle().getParam("go", go) || !go)) return;
    if (number_ == 0 && out_.getNumSubscribers() == 0) return;  // its link is not there yet
    if (number_ == count_) {
      timer_.stop();
      getPrivateNodeHandle().setParam("serialised", static_cast<int>(out_.serialised()));
      return;
    }
    auto image = Maker::make(out_);
    image->data.resize(static_cast<std::size_t>(bytes_));
    mark(*image, number_++);
    out_.publish(std::move(image));
  }

  int count_ = 600;
  int bytes_ = 100'000;
  int number_ = 0;
  lot::ros::Publisher<LotImage> out_;
  ros::Timer timer_;
};

struct InSharedMemory {
  static auto make(lot::ros::Publisher<LotImage>& out) { return out.loan(); }
};
struct OnTheHeap {
  static auto make(lot::ros::Publisher<LotImage>&) {
    return boost::make_shared<sensor_msgs::Image>();
  }
};

class Camera final : public AnyCamera<InSharedMemory> {};
class StandardCamera final : public AnyCamera<OnTheHeap> {};

}  // namespace lot_test

PLUGINLIB_EXPORT_CLASS(lot_test::Camera, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(lot_test::StandardCamera, nodelet::Nodelet)
