// SPDX-License-Identifier: Apache-2.0

// An image processor of stock ROS, before it is ported: edges_lot.cpp is the same after it.
//
//     ros_edges image:=/camera/image_raw edges:=/edges

#include <cv_bridge/cv_bridge.h>
#include <opencv2/imgproc.hpp>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

class Edges {
 public:
  explicit Edges(ros::NodeHandle node)
      : edges_(node.advertise<sensor_msgs::Image>("edges", 5)),
        images_(node.subscribe("image", 5, &Edges::find, this)) {}

 private:
  void find(const sensor_msgs::ImageConstPtr& image) {
    const auto grey = cv_bridge::toCvShare(image, "mono8");
    cv_bridge::CvImage edges(image->header, "mono8");
    cv::Canny(grey->image, edges.image, 50, 150);
    edges_.publish(edges.toImageMsg());
  }

  ros::Publisher edges_;
  ros::Subscriber images_;
};

int main(int argc, char** argv) {
  ros::init(argc, argv, "find_edges");
  const Edges edges{ros::NodeHandle()};
  ros::spin();
}
