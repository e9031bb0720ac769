#include "bench/bench_image.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace corvid {

GreyImage bench_image(int width_px, int height_px) {
  cv::RNG random(7);
  const cv::Size size(width_px, height_px);
  cv::Mat sum = cv::Mat::zeros(size, CV_32F), layer;
  float amplitude = 3;
  for (int scale = 2; scale <= 64; scale *= 2) {
    cv::Mat coarse(height_px / scale + 2, width_px / scale + 2, CV_32F);
    random.fill(coarse, cv::RNG::NORMAL, 0, 1);
    cv::resize(coarse, layer, size, 0, 0, cv::INTER_CUBIC);
    sum += amplitude * layer;
    amplitude *= 1.5F;
  }
  sum = cv::max(cv::min(sum, 95.0), -95.0);  // noise stays visible in the brightest places
  cv::Mat noise(size, CV_32F);
  random.fill(noise, cv::RNG::NORMAL, 128, 5);
  sum += noise;
  GreyImage image(width_px, height_px);
  cv::Mat grey(size, CV_8U, image.data());
  sum.convertTo(grey, CV_8U);
  return image;
}

}  // namespace corvid
