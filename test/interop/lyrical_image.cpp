// Copyright 2026 opencv_tools maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// A sensor_msgs/Image as ROS 2 Lyrical declares it, with the functions that opencv_tools calls.
//
// Its sequences of numbers have two more fields (rosidl_runtime_c/primitives_sequence.h).

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>

struct String { char * data; size_t size, capacity; };
struct Bytes { uint8_t * data; size_t size, capacity; bool is_rosidl_buffer, owns_rosidl_buffer; };
struct Time { int32_t sec; uint32_t nanosec; };
struct Header { Time stamp; String frame_id; };
struct Image {
  Header header;
  uint32_t height, width;
  String encoding;
  uint8_t is_bigendian;
  uint32_t step;
  Bytes data;
};
struct Images { Image * data; size_t size, capacity; };

static void set(String & text, const char * value)
{
  text.size = strlen(value);
  text.capacity = text.size + 1;
  text.data = static_cast<char *>(malloc(text.capacity));
  memcpy(text.data, value, text.capacity);
}

static void finish(Image & image)
{
  free(image.header.frame_id.data);
  free(image.encoding.data);
  if (!image.data.is_rosidl_buffer) {
    free(image.data.data);
  }
}

extern "C" {
size_t size_of_image() { return sizeof(Image); }

Images * sensor_msgs__msg__Image__Sequence__create(size_t count)
{
  Images * images = static_cast<Images *>(calloc(1, sizeof(Images)));
  images->data = static_cast<Image *>(calloc(count, sizeof(Image)));
  images->size = images->capacity = count;
  for (size_t i = 0; i < count; ++i) {
    set(images->data[i].header.frame_id, "");
    set(images->data[i].encoding, "");
  }
  return images;
}

void sensor_msgs__msg__Image__Sequence__destroy(Images * images)
{
  for (size_t i = 0; i < images->size; ++i) {
    finish(images->data[i]);
  }
  free(images->data);
  free(images);
}

void sensor_msgs__msg__Image__fini(Image * image) { finish(*image); }

// Fills an image; data of a rosidl::Buffer must never be read, so they point nowhere.
void fill(
  Image * image, int32_t sec, uint32_t nanosec, const char * frame_id, uint32_t height,
  uint32_t width, const char * encoding, uint8_t is_bigendian, uint32_t step, const uint8_t * data,
  size_t size, bool is_rosidl_buffer)
{
  finish(*image);
  *image = Image{{{sec, nanosec}, {}}, height, width, {}, is_bigendian, step,
    {reinterpret_cast<uint8_t *>(16), size, size, is_rosidl_buffer, false}};
  set(image->header.frame_id, frame_id);
  set(image->encoding, encoding);
  if (!is_rosidl_buffer) {
    image->data.data = static_cast<uint8_t *>(malloc(size));
    memcpy(image->data.data, data, size);
  }
}

// Reads an image that is published: the sum of its fields and of its data.
uint64_t sum(const Image * image)
{
  uint64_t total = image->header.stamp.sec + image->header.stamp.nanosec + image->height +
    image->width + image->is_bigendian + image->step + image->header.frame_id.size +
    image->encoding.size + 1000 * (image->data.is_rosidl_buffer + image->data.owns_rosidl_buffer);
  for (size_t i = 0; i < image->data.size; ++i) {
    total += image->data.data[i];
  }
  return total;
}
}
