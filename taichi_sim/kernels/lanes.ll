; Functions that kernels of whole vectors call (lanes.py). Taichi links lanes.bc, which this makes:
;
;     llvm-as lanes.ll -o lanes.bc          (LLVM 14 or 15; newer bitcode is unknown to Taichi's LLVM 15)
;
; Taichi's cache knows compiled kernels by the names of such functions: one that changes needs a new name.

target datalayout = "e-m:e-p270:32:32-p271:32:32-p272:64:64-i64:64-f80:128-n8:16:32:64-S128"

declare <16 x float> @llvm.fmuladd.v16f32(<16 x float>, <16 x float>, <16 x float>)

; out = a b + c, rounded once
define void @lanes_plus(<16 x float>* %out, <16 x float>* %a, <16 x float>* %b, <16 x float>* %c) alwaysinline {
  %x = load <16 x float>, <16 x float>* %a, align 4
  %y = load <16 x float>, <16 x float>* %b, align 4
  %z = load <16 x float>, <16 x float>* %c, align 4
  %r = call <16 x float> @llvm.fmuladd.v16f32(<16 x float> %x, <16 x float> %y, <16 x float> %z)
  store <16 x float> %r, <16 x float>* %out, align 4
  ret void
}

; out = a b - c, rounded once
define void @lanes_minus(<16 x float>* %out, <16 x float>* %a, <16 x float>* %b, <16 x float>* %c) alwaysinline {
  %x = load <16 x float>, <16 x float>* %a, align 4
  %y = load <16 x float>, <16 x float>* %b, align 4
  %z = load <16 x float>, <16 x float>* %c, align 4
  %negative = fneg <16 x float> %z
  %r = call <16 x float> @llvm.fmuladd.v16f32(<16 x float> %x, <16 x float> %y, <16 x float> %negative)
  store <16 x float> %r, <16 x float>* %out, align 4
  ret void
}

; out = c - a b, rounded once
define void @lanes_from(<16 x float>* %out, <16 x float>* %a, <16 x float>* %b, <16 x float>* %c) alwaysinline {
  %x = load <16 x float>, <16 x float>* %a, align 4
  %y = load <16 x float>, <16 x float>* %b, align 4
  %z = load <16 x float>, <16 x float>* %c, align 4
  %negative = fneg <16 x float> %x
  %r = call <16 x float> @llvm.fmuladd.v16f32(<16 x float> %negative, <16 x float> %y, <16 x float> %z)
  store <16 x float> %r, <16 x float>* %out, align 4
  ret void
}

; out = x in every lane
define void @lanes_spread(<16 x float>* %out, float* %x) alwaysinline {
  %value = load float, float* %x, align 4
  %first = insertelement <16 x float> undef, float %value, i32 0
  %all = shufflevector <16 x float> %first, <16 x float> undef, <16 x i32> zeroinitializer
  store <16 x float> %all, <16 x float>* %out, align 4
  ret void
}

; Reserves 64 bytes on the stack, aligned to 64. LLVM then aligns the whole frame, and no spilled vector straddles two
; cache lines.
define void @lanes_align_stack() alwaysinline {
  %place = alloca <16 x float>, align 64
  %byte = bitcast <16 x float>* %place to i8*
  store volatile i8 0, i8* %byte, align 64
  ret void
}

; out[k] = sum of the lanes of pk. Four steps of two shuffles and a sum: neighbours in a quarter, halves of a quarter,
; then quarters. After the first two, quarter l of a vector holds the sums of quarter l of four vectors.
define void @lanes_totals(<16 x float>* %out, <16 x float>* %p0, <16 x float>* %p1, <16 x float>* %p2, <16 x float>* %p3, <16 x float>* %p4, <16 x float>* %p5, <16 x float>* %p6, <16 x float>* %p7, <16 x float>* %p8, <16 x float>* %p9, <16 x float>* %p10, <16 x float>* %p11, <16 x float>* %p12, <16 x float>* %p13, <16 x float>* %p14, <16 x float>* %p15) alwaysinline {
  %v0 = load <16 x float>, <16 x float>* %p0, align 4
  %v1 = load <16 x float>, <16 x float>* %p1, align 4
  %v2 = load <16 x float>, <16 x float>* %p2, align 4
  %v3 = load <16 x float>, <16 x float>* %p3, align 4
  %v4 = load <16 x float>, <16 x float>* %p4, align 4
  %v5 = load <16 x float>, <16 x float>* %p5, align 4
  %v6 = load <16 x float>, <16 x float>* %p6, align 4
  %v7 = load <16 x float>, <16 x float>* %p7, align 4
  %v8 = load <16 x float>, <16 x float>* %p8, align 4
  %v9 = load <16 x float>, <16 x float>* %p9, align 4
  %v10 = load <16 x float>, <16 x float>* %p10, align 4
  %v11 = load <16 x float>, <16 x float>* %p11, align 4
  %v12 = load <16 x float>, <16 x float>* %p12, align 4
  %v13 = load <16 x float>, <16 x float>* %p13, align 4
  %v14 = load <16 x float>, <16 x float>* %p14, align 4
  %v15 = load <16 x float>, <16 x float>* %p15, align 4
  %t1 = shufflevector <16 x float> %v0, <16 x float> %v1, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t2 = shufflevector <16 x float> %v0, <16 x float> %v1, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t3 = fadd reassoc nsz <16 x float> %t1, %t2
  %t4 = shufflevector <16 x float> %v2, <16 x float> %v3, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t5 = shufflevector <16 x float> %v2, <16 x float> %v3, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t6 = fadd reassoc nsz <16 x float> %t4, %t5
  %t7 = shufflevector <16 x float> %t3, <16 x float> %t6, <16 x i32> <i32 0, i32 1, i32 16, i32 17, i32 4, i32 5, i32 20, i32 21, i32 8, i32 9, i32 24, i32 25, i32 12, i32 13, i32 28, i32 29>
  %t8 = shufflevector <16 x float> %t3, <16 x float> %t6, <16 x i32> <i32 2, i32 3, i32 18, i32 19, i32 6, i32 7, i32 22, i32 23, i32 10, i32 11, i32 26, i32 27, i32 14, i32 15, i32 30, i32 31>
  %t9 = fadd reassoc nsz <16 x float> %t7, %t8
  %t10 = shufflevector <16 x float> %v4, <16 x float> %v5, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t11 = shufflevector <16 x float> %v4, <16 x float> %v5, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t12 = fadd reassoc nsz <16 x float> %t10, %t11
  %t13 = shufflevector <16 x float> %v6, <16 x float> %v7, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t14 = shufflevector <16 x float> %v6, <16 x float> %v7, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t15 = fadd reassoc nsz <16 x float> %t13, %t14
  %t16 = shufflevector <16 x float> %t12, <16 x float> %t15, <16 x i32> <i32 0, i32 1, i32 16, i32 17, i32 4, i32 5, i32 20, i32 21, i32 8, i32 9, i32 24, i32 25, i32 12, i32 13, i32 28, i32 29>
  %t17 = shufflevector <16 x float> %t12, <16 x float> %t15, <16 x i32> <i32 2, i32 3, i32 18, i32 19, i32 6, i32 7, i32 22, i32 23, i32 10, i32 11, i32 26, i32 27, i32 14, i32 15, i32 30, i32 31>
  %t18 = fadd reassoc nsz <16 x float> %t16, %t17
  %t19 = shufflevector <16 x float> %v8, <16 x float> %v9, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t20 = shufflevector <16 x float> %v8, <16 x float> %v9, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t21 = fadd reassoc nsz <16 x float> %t19, %t20
  %t22 = shufflevector <16 x float> %v10, <16 x float> %v11, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t23 = shufflevector <16 x float> %v10, <16 x float> %v11, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t24 = fadd reassoc nsz <16 x float> %t22, %t23
  %t25 = shufflevector <16 x float> %t21, <16 x float> %t24, <16 x i32> <i32 0, i32 1, i32 16, i32 17, i32 4, i32 5, i32 20, i32 21, i32 8, i32 9, i32 24, i32 25, i32 12, i32 13, i32 28, i32 29>
  %t26 = shufflevector <16 x float> %t21, <16 x float> %t24, <16 x i32> <i32 2, i32 3, i32 18, i32 19, i32 6, i32 7, i32 22, i32 23, i32 10, i32 11, i32 26, i32 27, i32 14, i32 15, i32 30, i32 31>
  %t27 = fadd reassoc nsz <16 x float> %t25, %t26
  %t28 = shufflevector <16 x float> %v12, <16 x float> %v13, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t29 = shufflevector <16 x float> %v12, <16 x float> %v13, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t30 = fadd reassoc nsz <16 x float> %t28, %t29
  %t31 = shufflevector <16 x float> %v14, <16 x float> %v15, <16 x i32> <i32 0, i32 16, i32 1, i32 17, i32 4, i32 20, i32 5, i32 21, i32 8, i32 24, i32 9, i32 25, i32 12, i32 28, i32 13, i32 29>
  %t32 = shufflevector <16 x float> %v14, <16 x float> %v15, <16 x i32> <i32 2, i32 18, i32 3, i32 19, i32 6, i32 22, i32 7, i32 23, i32 10, i32 26, i32 11, i32 27, i32 14, i32 30, i32 15, i32 31>
  %t33 = fadd reassoc nsz <16 x float> %t31, %t32
  %t34 = shufflevector <16 x float> %t30, <16 x float> %t33, <16 x i32> <i32 0, i32 1, i32 16, i32 17, i32 4, i32 5, i32 20, i32 21, i32 8, i32 9, i32 24, i32 25, i32 12, i32 13, i32 28, i32 29>
  %t35 = shufflevector <16 x float> %t30, <16 x float> %t33, <16 x i32> <i32 2, i32 3, i32 18, i32 19, i32 6, i32 7, i32 22, i32 23, i32 10, i32 11, i32 26, i32 27, i32 14, i32 15, i32 30, i32 31>
  %t36 = fadd reassoc nsz <16 x float> %t34, %t35
  %t37 = shufflevector <16 x float> %t9, <16 x float> %t18, <16 x i32> <i32 0, i32 1, i32 2, i32 3, i32 8, i32 9, i32 10, i32 11, i32 16, i32 17, i32 18, i32 19, i32 24, i32 25, i32 26, i32 27>
  %t38 = shufflevector <16 x float> %t9, <16 x float> %t18, <16 x i32> <i32 4, i32 5, i32 6, i32 7, i32 12, i32 13, i32 14, i32 15, i32 20, i32 21, i32 22, i32 23, i32 28, i32 29, i32 30, i32 31>
  %t39 = fadd reassoc nsz <16 x float> %t37, %t38
  %t40 = shufflevector <16 x float> %t27, <16 x float> %t36, <16 x i32> <i32 0, i32 1, i32 2, i32 3, i32 8, i32 9, i32 10, i32 11, i32 16, i32 17, i32 18, i32 19, i32 24, i32 25, i32 26, i32 27>
  %t41 = shufflevector <16 x float> %t27, <16 x float> %t36, <16 x i32> <i32 4, i32 5, i32 6, i32 7, i32 12, i32 13, i32 14, i32 15, i32 20, i32 21, i32 22, i32 23, i32 28, i32 29, i32 30, i32 31>
  %t42 = fadd reassoc nsz <16 x float> %t40, %t41
  %t43 = shufflevector <16 x float> %t39, <16 x float> %t42, <16 x i32> <i32 0, i32 1, i32 2, i32 3, i32 8, i32 9, i32 10, i32 11, i32 16, i32 17, i32 18, i32 19, i32 24, i32 25, i32 26, i32 27>
  %t44 = shufflevector <16 x float> %t39, <16 x float> %t42, <16 x i32> <i32 4, i32 5, i32 6, i32 7, i32 12, i32 13, i32 14, i32 15, i32 20, i32 21, i32 22, i32 23, i32 28, i32 29, i32 30, i32 31>
  %t45 = fadd reassoc nsz <16 x float> %t43, %t44
  store <16 x float> %t45, <16 x float>* %out, align 4
  ret void
}
