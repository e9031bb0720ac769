#pragma once

#include <memory>
#include <vector>

#include "core/clock.h"
#include "corvid/error.h"
#include "io/camera/camera_stream.h"

namespace corvid {

/// The V4L2 devices of this machine that deliver pictures, in the order of their numbers. A device
/// that another program uses, or that may not be opened, is listed with its problem; nodes that do
/// not capture pictures (the metadata of UVC cameras, outputs) are not.
[[nodiscard]] std::vector<CameraListing> list_v4l2_cameras();

/// Opens the node `request.device`, sets it up and starts it. Without a format, the best for grey
/// pictures is taken among those that have the size and rate asked for. Without a size, or a rate,
/// the device's own is left. What the driver set instead of what was asked is told in the
/// settings' notes; only a format is insisted on.
/// @param clock  gives the times of arrival, where the driver has no usable ones; outlives the
///               stream.
/// Errors: not_found; io (permission, in use by another program, gone, a request that the driver
/// refused); unsupported (no V4L2 device, none that captures, a format that the device has not or
/// that is not understood).
[[nodiscard]] Expected<std::unique_ptr<CameraStream>> open_v4l2(const CameraRequest& request,
                                                                Clock& clock);

}  // namespace corvid
