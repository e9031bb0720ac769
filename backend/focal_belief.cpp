#include "backend/focal_belief.h"

#include <algorithm>
#include <cmath>

namespace corvid {
namespace {

constexpr double kGoodSigma = 0.005, kWrongSigma = 0.1;
constexpr double kWrong = 0.05;  ///< of the calibrations, before any image was seen

}  // namespace

void FocalBelief::add(const FocalEstimate& estimate, int overlap) {
  if (!(estimate.sigma > 0) || !std::isfinite(estimate.share)) return;
  const double weight = 1 / (estimate.sigma * estimate.sigma);
  weight_ += weight;
  weighted_ += weight * estimate.share;
  ++count_;
  overlap_ = std::max(1, overlap);
}

void FocalBelief::clear() {
  weight_ = weighted_ = 0;
  count_ = 0;
}

double FocalBelief::asked() const { return weight_ > 0 ? weighted_ / weight_ : 0; }

double FocalBelief::sigma() const {
  return std::sqrt(static_cast<double>(std::min(count_, overlap_)) / weight_);
}

FocalBelief::Part FocalBelief::part(double prior_sigma, double prior_probability) const {
  const double prior = prior_sigma * prior_sigma;
  if (!(weight_ > 0)) return {prior_probability, prior};
  const double own = sigma() * sigma();
  // Normal prior, normal estimate; the evidence is that of the estimate under both.
  const double mean = asked() * prior / (prior + own);
  const double evidence =
      std::exp(-0.5 * asked() * asked() / (prior + own)) / std::sqrt(prior + own);
  return {prior_probability * evidence, mean * mean + prior * own / (prior + own)};
}

double FocalBelief::wrong() const {
  const Part good = part(kGoodSigma, told_ ? 1 - kWrong : 0),
             wrong = part(kWrongSigma, told_ ? kWrong : 1);
  const double sum = good.probability + wrong.probability;
  return sum > 0 ? wrong.probability / sum : 1;
}

double FocalBelief::square() const {
  const double w = wrong();
  return (1 - w) * part(kGoodSigma, 1).square + w * part(kWrongSigma, 1).square;
}

}  // namespace corvid
