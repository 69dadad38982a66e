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

// Prints files as libsdformat reads them: poses FILE..., as one JSON object by file. With the
// argument - it reads names of files from standard input and prints one line for each.
//
// The result of a file has "loaded" (no errors), "valid" (also by the checks of `ign sdf -k`),
// "messages" and "models". A model has its pose in the world, and the poses of its links, joints,
// frames, visuals, collisions and centres of mass in the model frame, [x, y, z, qw, qx, qy, qz].
// Names in a nested model have the prefix arm::.

#include <cmath>
#include <filesystem>
#include <initializer_list>
#include <iomanip>
#include <iostream>
#include <map>
#include <sstream>
#include <streambuf>
#include <string>
#include <utility>

#include <sdf/sdf.hh>

using Pose = ignition::math::Pose3d;
using Group = std::map<std::string, std::string>;
using Groups = std::map<std::string, Group>;

std::string literal(const std::string & text)
{
  std::ostringstream out;
  out << '"';
  for (const unsigned char c : text) {
    if (c == '"' || c == '\\') {
      out << '\\' << c;
    } else if (c < 0x20) {
      out << "\\u" << std::hex << std::setw(4) << std::setfill('0') << int(c) << std::dec;
    } else {
      out << c;
    }
  }
  out << '"';
  return out.str();
}

std::string numbers(const std::initializer_list<double> & values)
{
  std::ostringstream out;
  out << std::setprecision(17);
  for (const double value : values) {
    // JSON has no infinity.
    const double finite = std::isfinite(value) ? value : std::copysign(1e300, value);
    out << (out.tellp() ? ", " : "[") << finite;
  }
  out << ']';
  return out.str();
}

std::string json(const Pose & pose)
{
  const auto & p = pose.Pos();
  const auto & q = pose.Rot();
  return numbers({p.X(), p.Y(), p.Z(), q.W(), q.X(), q.Y(), q.Z()});
}

std::string json(const Group & group)
{
  std::string out;
  for (const auto & [name, value] : group) {
    out += (out.empty() ? "{" : ", ") + literal(name) + ": " + value;
  }
  return out.empty() ? "{}" : out + "}";
}

// Returns the pose of an object in the frame of its model.
template<typename Part>
Pose placed(const Part & part, std::string & errors)
{
  Pose pose;
  for (const auto & error : part.SemanticPose().Resolve(pose, "__model__")) {
    errors += error.Message() + "\n";
  }
  return pose;
}

std::string axis(const sdf::JointAxis & axis, const sdf::Joint & joint, std::string & errors)
{
  ignition::math::Vector3d xyz;
  for (const auto & error : axis.ResolveXyz(xyz, joint.Name())) {
    errors += error.Message() + "\n";
  }
  return numbers({xyz.X(), xyz.Y(), xyz.Z(), axis.Lower(), axis.Upper(), axis.Effort(),
      axis.MaxVelocity(), axis.Damping(), axis.Friction()});
}

void add(
  const sdf::Model & model, const std::string & prefix, const Pose & base, Groups & groups,
  std::string & errors)
{
  for (uint64_t i = 0; i < model.LinkCount(); ++i) {
    const auto & link = *model.LinkByIndex(i);
    const auto name = prefix + link.Name();
    const Pose pose = base * placed(link, errors);
    groups["links"][name] = json(pose);
    const auto inertial = link.Inertial();
    groups["inertials"][name] = json(pose * inertial.Pose());
    const auto & mass = inertial.MassMatrix();
    groups["masses"][name] = numbers(
      {mass.Mass(), mass.Ixx(), mass.Ixy(), mass.Ixz(), mass.Iyy(), mass.Iyz(), mass.Izz()});
    for (uint64_t j = 0; j < link.VisualCount(); ++j) {
      const auto & visual = *link.VisualByIndex(j);
      Pose local;
      visual.SemanticPose().Resolve(local, link.Name());
      groups["visuals"][name + "/" + visual.Name()] = json(pose * local);
    }
    for (uint64_t j = 0; j < link.CollisionCount(); ++j) {
      const auto & collision = *link.CollisionByIndex(j);
      Pose local;
      collision.SemanticPose().Resolve(local, link.Name());
      groups["collisions"][name + "/" + collision.Name()] = json(pose * local);
    }
  }
  for (uint64_t i = 0; i < model.JointCount(); ++i) {
    const auto & joint = *model.JointByIndex(i);
    const auto name = prefix + joint.Name();
    groups["joints"][name] = json(base * placed(joint, errors));
    for (unsigned int j = 0; j < 2; ++j) {
      if (joint.Axis(j) != nullptr) {
        groups["axes"][name + "/" + std::to_string(j)] = axis(*joint.Axis(j), joint, errors);
      }
    }
  }
  for (uint64_t i = 0; i < model.FrameCount(); ++i) {
    const auto & frame = *model.FrameByIndex(i);
    groups["frames"][prefix + frame.Name()] = json(base * placed(frame, errors));
  }
  for (uint64_t i = 0; i < model.ModelCount(); ++i) {
    const auto & inner = *model.ModelByIndex(i);
    const auto name = prefix + inner.Name() + "::";
    const Pose pose = base * placed(inner, errors);
    groups["frames"][name + "__model__"] = json(pose);
    add(inner, name, pose, groups, errors);
  }
}

std::string description(const sdf::Model & model)
{
  Groups groups;
  std::string errors;
  add(model, "", Pose::Zero, groups, errors);
  Group out;
  out["errors"] = literal(errors);
  out["in_world"] = json(model.RawPose());
  for (const auto & [name, group] : groups) {
    out[name] = json(group);
  }
  return json(out);
}

// Captures the output of a stream during its lifetime.
class CapturedStream
{
public:
  explicit CapturedStream(std::ostream & stream)
  : stream(stream), before(stream.rdbuf(text.rdbuf())) {}
  ~CapturedStream() {stream.rdbuf(before);}
  std::string str() const {return text.str();}

private:
  std::ostringstream text;
  std::ostream & stream;
  std::streambuf * before;
};

std::string result_of(const std::string & path)
{
  sdf::setFindCallback(
    [&](const std::string & uri) {
      const auto name = uri.substr(0, 8) == "model://" ? uri.substr(8) : uri;
      return (std::filesystem::path(path).parent_path() / name).string();
    });
  CapturedStream messages(std::cerr);
  sdf::Root root;
  const auto errors = root.Load(path);
  for (const auto & error : errors) {
    std::cerr << error.Message() << std::endl;
  }
  const bool valid = errors.empty() && sdf::checkCanonicalLinkNames(&root) &&
    sdf::checkFrameAttachedToNames(&root) && sdf::checkJointParentChildLinkNames(&root) &&
    sdf::checkFrameAttachedToGraph(&root) && sdf::checkPoseRelativeToGraph(&root) &&
    sdf::recursiveSiblingUniqueNames(root.Element()) &&
    sdf::recursiveSiblingNoDoubleColonInNames(root.Element());
  Group models;
  if (root.Model() != nullptr) {
    models[root.Model()->Name()] = description(*root.Model());
  }
  for (uint64_t i = 0; i < root.WorldCount(); ++i) {
    for (uint64_t j = 0; j < root.WorldByIndex(i)->ModelCount(); ++j) {
      const auto & model = *root.WorldByIndex(i)->ModelByIndex(j);
      models[model.Name()] = description(model);
    }
  }
  return json(
    Group{{"loaded", errors.empty() ? "true" : "false"}, {"valid", valid ? "true" : "false"},
      {"messages", literal(messages.str())}, {"models", json(models)}});
}

int main(int count, char ** arguments)
{
  std::string path;
  if (count == 2 && std::string(arguments[1]) == "-") {
    while (std::getline(std::cin, path)) {
      std::cout << json(Group{{path, result_of(path)}}) << std::endl;
    }
    return 0;
  }
  Group files;
  for (int i = 1; i < count; ++i) {
    files[arguments[i]] = result_of(arguments[i]);
  }
  std::cout << json(files) << std::endl;
  return 0;
}
