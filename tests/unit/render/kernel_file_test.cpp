#include "render/shadow/kernels/kernel_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/model_text.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

// The same square in two files with different orders of `v` lines.
constexpr const char* kSquare =
    "v 0 0 0.1\nv 1 0 0.1\nv 1 1 0.1\nv 0 1 0.1\nv 0.5 0.5 0.4\n"
    "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
constexpr const char* kReordered =
    "v 0.5 0.5 0.4\nv 0 0 0.1\nv 1 0 0.1\nv 1 1 0.1\nv 0 1 0.1\n"
    "f 2 3 1\nf 3 4 1\nf 4 5 1\nf 5 2 1\n";

KernelFile kernel_file_for(const Model& model) {
  const ShadowMesh mesh = make_shadow_mesh(model);
  return make_kernel_file(model, mesh,
                          generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic),
                          KernelSource::automatic);
}

TEST(KernelFile, IsRejectedForReorderedVertices) {
  const test::ModelFolder folder;
  const auto first = folder.obj(kSquare);
  ASSERT_TRUE(first) << first.error().message;
  const auto file = folder.write("kernels.json", kernel_file_json(kernel_file_for(*first)));
  const auto kernels = load_kernel_file(file);
  ASSERT_TRUE(kernels) << kernels.error().message;

  auto same = folder.obj(kSquare);
  auto other = folder.obj(kReordered);
  ASSERT_TRUE(same && other);
  EXPECT_EQ(geometry_key(*same), geometry_key(*other)) << "their surfaces are the same";
  const auto attached = attach_kernels(*same, *kernels, "kernels.json");
  ASSERT_TRUE(attached) << attached.error().message;
  EXPECT_TRUE(*attached);
  const auto rejected = attach_kernels(*other, *kernels, "kernels.json");
  ASSERT_TRUE(rejected) << rejected.error().message;
  EXPECT_FALSE(*rejected);
  ASSERT_EQ(other->warnings.size(), 1U);
  EXPECT_THAT(other->warnings[0], HasSubstr("was made before the model \"model\" changed"));
}

TEST(KernelFile, AcceptsFileWithoutVertexOrder) {
  const test::ModelFolder folder;
  auto model = folder.obj(kSquare);
  ASSERT_TRUE(model) << model.error().message;
  KernelFile kernels = kernel_file_for(*model);
  kernels.vertex_order.clear();
  kernels.geometry.clear();
  const auto attached = attach_kernels(*model, kernels, "kernels.json");
  ASSERT_TRUE(attached) << attached.error().message;
  EXPECT_TRUE(*attached);
}

}  // namespace
}  // namespace penumbra
