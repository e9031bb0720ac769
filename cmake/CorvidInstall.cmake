# Installs the library (headers, one static archive per room, a package file for
# find_package(corvid)) and the program.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(CORVID_ROOMS core kernels frontend backend mapping io replay engine)
set(CORVID_PACKAGE_DIR "${CMAKE_INSTALL_LIBDIR}/cmake/corvid")
list(TRANSFORM CORVID_ROOMS PREPEND corvid_ OUTPUT_VARIABLE room_targets)

install(DIRECTORY include/corvid DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
# The openers of sources, trajectories, options and meshes are for the library's users, too. They keep
# the names that they have in the tree, below a folder of their own.
set(CORVID_ROOM_HEADERS "${CMAKE_INSTALL_INCLUDEDIR}/corvid/rooms")
install(FILES io/source.h io/calibration.h io/trajectory_file.h io/positions_file.h io/options_file.h io/mesh_files.h
              io/recording_writer.h
        DESTINATION ${CORVID_ROOM_HEADERS}/io)
install(FILES replay/synthetic_flight.h replay/player.h replay/recorder.h replay/recording.h
              replay/async_recorder.h
        DESTINATION ${CORVID_ROOM_HEADERS}/replay)
install(FILES core/check.h core/clock.h core/log.h core/source_decorator.h DESTINATION ${CORVID_ROOM_HEADERS}/core)
target_include_directories(corvid_core INTERFACE $<INSTALL_INTERFACE:${CORVID_ROOM_HEADERS}>)
install(TARGETS ${room_targets} corvid_draco corvid_opencv EXPORT corvid_targets
        ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(EXPORT corvid_targets NAMESPACE corvid:: FILE corvid-targets.cmake
        DESTINATION ${CORVID_PACKAGE_DIR})
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/corvidConfig.cmake.in
  ${PROJECT_BINARY_DIR}/corvidConfig.cmake INSTALL_DESTINATION ${CORVID_PACKAGE_DIR})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/corvidConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/corvidConfig.cmake ${PROJECT_BINARY_DIR}/corvidConfigVersion.cmake
        DESTINATION ${CORVID_PACKAGE_DIR})

install(TARGETS corvid_program RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
configure_file(packaging/corvid.service.in ${PROJECT_BINARY_DIR}/corvid.service @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/corvid.service DESTINATION lib/systemd/system)
install(FILES packaging/live.conf DESTINATION ${CMAKE_INSTALL_DOCDIR}/examples)
install(FILES README.md LICENSE NOTICE CHANGELOG.md DESTINATION ${CMAKE_INSTALL_DOCDIR})

# A consumer's project, built against an installed copy.
if(CORVID_TESTS)
  add_test(NAME install.consumer
           COMMAND ${CMAKE_COMMAND} -DBUILD=${PROJECT_BINARY_DIR} -DSOURCE=${PROJECT_SOURCE_DIR}
                   -DWORK=${PROJECT_BINARY_DIR}/install-test -DCXX=${CMAKE_CXX_COMPILER}
                   "-DFLAGS=${CORVID_SANITIZE_FLAGS}" -P ${PROJECT_SOURCE_DIR}/tests/install/check.cmake)
  set_tests_properties(install.consumer PROPERTIES LABELS slow TIMEOUT 900)
endif()
