#pragma once

namespace corvid {

/// A focal length that images ask for: by which share it should be larger than told.
struct FocalEstimate {
  double share = 0;
  double sigma = 0;  ///< 0: there is none
};

/// What is to be believed of the focal length that was told, from what adjustments ask for.
///
/// Most calibrations are good to half a percent; some belong to another camera or another mode of
/// it, and are wrong by ten. So the prior is a mixture of two normal distributions, and what the
/// images say moves the weight from one to the other (Bayes' rule for each, in closed form).
class FocalBelief {
 public:
  /// @param told  a calibration; otherwise a guess, that the adjustment refines: the wide part of
  ///        the prior alone.
  explicit FocalBelief(bool told) : told_(told) {}
  /// An estimate of a window of `overlap` keyframes, of which the next one shares all but one:
  /// that many estimates together are worth one.
  void add(const FocalEstimate& estimate, int overlap);
  /// Forgets the estimates: the focal length changed.
  void clear();
  /// Expected squared share by which the focal length in use is wrong.
  [[nodiscard]] double square() const;
  /// Probability that the calibration is of the wrong kind.
  [[nodiscard]] double wrong() const;
  /// The share that all estimates together ask for.
  [[nodiscard]] double asked() const;

 private:
  struct Part {
    double probability = 0, square = 0;
  };
  [[nodiscard]] Part part(double prior_sigma, double prior_probability) const;
  [[nodiscard]] double sigma() const;

  bool told_;
  double weight_ = 0, weighted_ = 0;
  int count_ = 0, overlap_ = 1;
};

}  // namespace corvid
