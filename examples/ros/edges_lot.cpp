// SPDX-License-Identifier: Apache-2.0

// The image processor of edges.cpp, ported: it reads images where they lie, and writes edges where
// others read them.
//
//     ros_edges_lot image:=/camera/image_raw edges:=/edges

#include <utility>

#include <opencv2/imgproc.hpp>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <lot/ros.hpp>
#include <lot/ros/opencv.hpp>
#include <lot/signals.hpp>

using Image = lot::ros::Message<sensor_msgs::Image_>;

class Edges {
 public:
  explicit Edges(lot::ros::NodeHandle node)
      : edges_(node.advertise<Image>("edges", 5)),
        images_(node.subscribe("image", 5, &Edges::find, this)) {}

 private:
  void find(const boost::shared_ptr<Image const>& image) {
    const auto grey = cv_bridge::toCvShare(image, "mono8");
    try {
      auto edges = lot::ros::loan_image(edges_, grey->image.rows, grey->image.cols, "mono8");
      edges->header = image->header;
      cv::Mat there = lot::ros::view(*edges);
      cv::Canny(grey->image, there, 50, 150);
      edges_.publish(std::move(edges));
    } catch (const lot::OutOfMemory& e) {  // subscribers keep more than the segment has room for
      ROS_WARN_THROTTLE(1, "an image is dropped: %s", e.what());
    }
  }

  lot::ros::Publisher<Image> edges_;
  lot::ros::Subscriber images_;
};

int main(int argc, char** argv) {
  lot::end_cleanly_on_signals();  // SIGTERM; SIGINT is roscpp's
  ros::init(argc, argv, "find_edges");
  const Edges edges{lot::ros::NodeHandle()};
  ros::spin();
}
