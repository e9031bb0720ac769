# corvid_embed_kernels(TARGET): every .cl file of the current folder becomes a byte array in TARGET, with its SHA-256.
function(corvid_embed_kernels target)
  file(GLOB kernels CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/*.cl")
  set(output "${CMAKE_CURRENT_BINARY_DIR}/embedded_kernels.cpp")
  set(script "${PROJECT_SOURCE_DIR}/cmake/embed_kernels_script.cmake")
  add_custom_command(OUTPUT "${output}"
    COMMAND ${CMAKE_COMMAND} "-DKERNELS=${kernels}" "-DOUTPUT=${output}" -P "${script}"
    DEPENDS ${kernels} "${script}" COMMENT "Embedding OpenCL kernels" VERBATIM)
  target_sources(${target} PRIVATE "${output}")
endfunction()
