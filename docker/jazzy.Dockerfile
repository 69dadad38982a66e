# The package in a workspace with the ROS 2 Jazzy of apt. In the root of the project:
#
#     docker build --file docker/jazzy.Dockerfile --tag opencv_tools .
#     docker run --rm --init --network host --ipc host opencv_tools \
#       ros2 run opencv_tools img_publisher --ros-args -p source:=pattern
#
# The build fails where the commands of the tutorial, a launch file or rosbag2 do.
FROM ros:jazzy
COPY . /opt/opencv_tools
ENV WORKSPACE=/opt/dev_ws VENV=/opt/ros_venv
RUN /opt/opencv_tools/.ci/jazzy install build && rm -rf /var/lib/apt/lists/*
RUN /opt/opencv_tools/.ci/jazzy tutorial launch bag && rm -r $WORKSPACE/trial
ENTRYPOINT ["bash", "-c", "source /opt/dev_ws/install/setup.bash && exec \"$@\"", "bash"]
CMD ["bash"]
